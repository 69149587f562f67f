"""What the add-on and the backend agree on: both import these very files, so there is no second copy.

Standard library and numpy alone, and only relative imports: the add-on loads this folder as a package of its own.

    errors        what can go wrong, and the exit codes
    scene_folder  the scene on disk
    triangles     the mesh in it, as an OBJ file
    command       the command line of a recovery
    protocol      the JSON lines of a run, as dataclasses
    report        the result folder
    vocabulary    presets, models of light, their components, stages, formats, devices
    known_colour  a spot of known albedo
    text          durations and sizes as people say them
"""
