"""Albedo and irradiance fields, and how they are fitted to the photos."""
