"""What lives in the .blend, as functions on Blender data. Knows nothing of the backend but the contract."""
