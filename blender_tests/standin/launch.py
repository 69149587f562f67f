"""A stand-in for the backend: speaks the same JSON lines, writes a result of one colour, needs no torch.

For the fast tests of the add-on only. The environment variable STANDIN says how it behaves:
`done` (default), `slow` (until cancelled), `stubborn` (as slow, ignores SIGTERM, as does a child it starts),
`crash`, `bad` (exit code 2), `silent` (says nothing).
"""

import argparse
import json
import os
import signal
import struct
import subprocess
import sys
import time
import zlib
from pathlib import Path

COLOUR = (200, 120, 40)


def say(**message):
    print(json.dumps(message), flush=True)


def png(path, rows, kind):
    """Write rows of bytes as a PNG of colour type `kind` (0 grey, 2 RGB)."""
    width = len(rows[0]) // (3 if kind == 2 else 1)

    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    header = struct.pack(">IIBBBBB", width, len(rows), 8, kind, 0, 0, 0)
    body = zlib.compress(b"".join(b"\0" + row for row in rows))
    start = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header)
    path.write_bytes(start + chunk(b"IDAT", body) + chunk(b"IEND", b""))


def main():
    if sys.argv[1] == "doctor":
        print("stand-in: no torch")
        return 0
    parser = argparse.ArgumentParser()
    parser.add_argument("command")
    parser.add_argument("scene", type=Path)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--format")
    parser.add_argument("--unwrap", action="store_true")
    options, _ = parser.parse_known_args()
    mode = os.environ.get("STANDIN", "done")
    frames = json.loads((options.scene / "transforms.json").read_text())["frames"]
    say(stage="scene", step=len(frames), total=len(frames), loss=None, seconds_left=None)
    expected = {
        "seconds": {"start": 2.0, "optimise": 38.0},
        "total_seconds": 40.0,
        "albedo_psnr_after_gain": {"mean": 24.9, "lowest": 21.0, "highest": 28.5},
    }
    say(stage="expected", **expected)
    plan = [{"what": "groups", "choice": "one light", "reason": "held-out photos say so", "costs": "nothing"}]
    say(stage="planned", decisions=plan)
    if mode == "bad":
        say(stage="error", code=2, message="mesh.obj has no UVs; unwrap it.")
        return 2
    if mode == "crash":
        print("Traceback: something unforeseen", file=sys.stderr, flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
    if mode == "stubborn":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])  # inherits SIG_IGN
        (options.scene / "child.pid").write_text(str(child.pid))
    if mode == "silent":
        time.sleep(60)
    steps = 600 if mode in ("slow", "stubborn") else int(os.environ.get("STANDIN_STEPS", "5"))
    for step in range(steps):
        say(
            stage="optimise", step=step, total=steps, loss=1.0 / (step + 1), seconds_left=0.1 * (steps - step)
        )
        time.sleep(0.1 if steps > 5 else 0.01)
    options.out.mkdir(parents=True, exist_ok=True)
    if options.unwrap:  # the mesh as it is
        (options.out / "mesh.obj").write_bytes((options.scene / "mesh.obj").read_bytes())
    png(options.out / "albedo.png", [bytes(COLOUR) * 8] * 8, 2)
    png(options.out / "coverage.png", [b"\xff" * 8] * 8, 0)
    report = {
        "held_out_psnr": 31.5,
        "coverage": 0.75,
        "seconds": {"start": 2.5, "optimise": 39.0},
        "expected": expected,
        "plan": plan,
        "arguments": sys.argv[1:],
        "settings": {"format": "png", "unwrap": options.unwrap},
        "python_variables": sorted(name for name in os.environ if name.startswith("PYTHON")),
    }
    (options.out / "report.json").write_text(json.dumps(report))
    say(stage="done", out=str(options.out), report=report)
    return 0


if __name__ == "__main__":
    sys.exit(main())
