"""Build the extension: `python3 build_addon.py` writes dist/dante_w-<version>.zip and prints its path.

Pure Python, standard library only. The same sources give the same bytes: files in order, with fixed times and
permissions. Inside: the add-on at the top, the backend's sources under backend/, blender_manifest.toml.
"""

from __future__ import annotations

import re
import sys
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent
TIME = (2026, 1, 1, 0, 0, 0)


def contents(root: Path = ROOT) -> dict[str, bytes]:
    """Path in the zip and bytes of every file.

    Raises:
        ValueError: the manifest's version is not the backend's.
    """
    manifest = (root / "manifest.toml").read_bytes()
    version = tomllib.loads(manifest.decode())["version"]
    backend = backend_version(root)
    if version != backend:
        raise ValueError(f"manifest.toml has version {version}, backend/dante_w {backend}; make them one.")
    files = {"blender_manifest.toml": b"# Made by build_addon.py from manifest.toml.\n" + manifest}
    addon = root / "dante_w_addon"
    for path in sorted(addon.rglob("*.py")):
        files[path.relative_to(addon).as_posix()] = path.read_bytes()
    backend_folder = root / "backend"
    package = backend_folder / "dante_w"
    sources = sorted([*package.rglob("*.py"), *package.rglob("*.json")])
    for path in [backend_folder / "launch.py", backend_folder / "requirements.txt", *sources]:
        files[path.relative_to(root).as_posix()] = path.read_bytes()
    if (root / "LICENSE").is_file():
        files["LICENSE"] = (root / "LICENSE").read_bytes()
    # Line endings may differ between checkouts of the same commit.
    return {name: data.replace(b"\r\n", b"\n") for name, data in sorted(files.items())}


def backend_version(root: Path = ROOT) -> str:
    """`__version__` of the backend, read without importing it."""
    text = (root / "backend" / "dante_w" / "__init__.py").read_text(encoding="utf-8")
    return re.search(r'^__version__ = "([^"]+)"', text, re.MULTILINE).group(1)


def build(folder: Path, root: Path = ROOT) -> Path:
    """Write the zip into `folder`; returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / f"dante_w-{backend_version(root)}.zip"
    with zipfile.ZipFile(target, "w") as archive:
        for name, data in contents(root).items():
            entry = zipfile.ZipInfo(name, TIME)
            entry.external_attr = 0o100644 << 16
            entry.create_system = 3  # the permissions above are Unix ones, also where this runs on Windows
            entry.compress_type = zipfile.ZIP_STORED  # zlib's versions compress differently
            archive.writestr(entry, data)
    return target


if __name__ == "__main__":
    try:
        print(build(ROOT / "dist"))
    except ValueError as error:
        sys.exit(str(error))
