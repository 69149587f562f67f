"""Run by the backend's Python: project the points in a JSON file with the backend's own cameras.

python project.py SCENE POINTS.json > PIXELS.json
"""

import json
import sys
from pathlib import Path

import numpy as np
from dante_w.contract.scene_folder import read_scene
from dante_w.scene.cameras import project

points = np.array(json.loads(Path(sys.argv[2]).read_text()))
frames = read_scene(Path(sys.argv[1])).frames
print(json.dumps([project(frame.camera, frame.camera_to_world, points).tolist() for frame in frames]))
