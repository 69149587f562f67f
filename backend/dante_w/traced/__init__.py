"""Light traced through the mesh: irradiance from visibility, lights and exposures by variable projection."""
