"""The sidebar tab, the preferences, and the rings in the 3D view."""
