"""Where each pixel meets the mesh, traced once and kept."""
