"""What comes in: scene folders, COLMAP models, cameras, photos, meshes."""
