"""The contract between add-on and backend: it stands once, both sides use it, and it reads what older versions wrote."""

from __future__ import annotations

import ast
import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dante_w.commands import cli
from dante_w.contract import errors, report, scene_folder, text, vocabulary
from dante_w.contract.command import Request
from dante_w.contract.known_colour import parse_known_colour
from dante_w.contract.protocol import (
    Decision,
    Done,
    Expected,
    Failed,
    Message,
    Planned,
    Quality,
    Step,
    decode,
    encode,
    read_decisions,
    read_expected,
)
from dante_w.contract.triangles import Triangles, read_obj, write_obj
from dante_w.presets import PRESETS
from dante_w.scene.mesh import read_mesh

ROOT = Path(__file__).resolve().parents[2]
CONTRACT = ROOT / "backend/dante_w/contract"
SIDES = [
    path
    for folder in ("backend/dante_w", "dante_w_addon")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if CONTRACT not in path.parents
]
COMPONENT_KEYS = [component.key for component in vocabulary.COMPONENTS]
COMPONENT_NAMES = [component.name for component in vocabulary.COMPONENTS]
#: Words of which a list of most of them, anywhere else, would be a copy.
LISTS = [
    set(vocabulary.PRESETS),
    set(vocabulary.MODELS),
    set(vocabulary.FORMATS),
    set(vocabulary.DEVICES),
    set(COMPONENT_KEYS),
    set(COMPONENT_NAMES),
    *map(set, vocabulary.STAGES.values()),
]
#: What the contract defines, and a file elsewhere must not define again.
DEFINED = {
    name
    for module in (errors, report, scene_folder, text, vocabulary)
    for name, value in vars(module).items()
    if not name.startswith("_") and getattr(value, "__module__", module.__name__) == module.__name__
}


# --- it stands once -------------------------------------------------------------------------------


def copies(source: str) -> Iterator[str]:
    """What of the contract a Python source says again."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Tuple | ast.List | ast.Set):
            words = [each.value for each in node.elts if isinstance(each, ast.Constant)]
            if len(words) == len(node.elts) and len(words) > 1:
                yield from (
                    f"{words}"
                    for known in LISTS
                    if set(words) <= known and len(set(words)) >= 0.7 * len(known)
                )
    for node in tree.body:
        names = [node.name] if isinstance(node, ast.ClassDef | ast.FunctionDef) else []
        if isinstance(node, ast.Assign):
            names = [
                name.id for target in node.targets for name in ast.walk(target) if isinstance(name, ast.Name)
            ]
        yield from (name for name in names if name in DEFINED)


def test_nothing_of_the_contract_stands_twice():
    #: Same word, another idea: settings of each preset, photos that can be read.
    allowed = {
        "backend/dante_w/presets.py PRESETS",
        "backend/dante_w/scene/images.py FORMATS",
    }
    found = {
        f"{path.relative_to(ROOT).as_posix()} {copy}"
        for path in SIDES
        for copy in copies(path.read_text("utf-8"))
    }
    assert not found - allowed


@pytest.mark.parametrize(
    "source",
    [
        "choices=('draft', 'standard', 'high', 'paper')",
        "NAMES = ['scene', 'rays', 'transfer', 'plan', 'lights', 'albedo', 'bake']",
        "DONE, BUG, BAD_INPUT = 0, 1, 2",
        "CANCELLED = 3",
        "def duration(seconds): ...",
        "class BadInput(Exception): ...",
        "add(choices={'auto', 'cpu', 'cuda'})",
        "PARTS = ('groups', 'exposures', 'bounce', 'gloss', 'sun')",
        "FORMATS = {'png': 8, 'exr': 16}",
    ],
)
def test_a_copy_is_found(source):
    assert list(copies(source))


def test_the_contract_imports_only_the_standard_library_numpy_and_itself():
    for path in CONTRACT.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and not node.level:
                modules = [node.module or ""]
            else:
                continue
            assert {module.split(".")[0] for module in modules} <= {*sys.stdlib_module_names, "numpy"}


def test_the_add_on_knows_the_backend_by_the_contract_alone():
    """Names of files, options and keys that both sides use are the contract's."""
    for path in sorted((ROOT / "dante_w_addon").rglob("*.py")):
        words = {
            node.value
            for node in ast.walk(ast.parse(path.read_text("utf-8")))
            if isinstance(node, ast.Constant) and isinstance(node.value, str)
        }
        shared = {report.REPORT, report.COVERAGE, "albedo.png", "albedo.exr", "held_out_psnr", "seconds_left"}
        assert not words & shared, path.name


# --- the vocabulary ---------------------------------------------------------------------------------


def test_every_model_has_presets_and_stages():
    assert set(vocabulary.MODELS) == set(vocabulary.MODEL_PRESETS) == set(vocabulary.STAGES)
    assert {preset for presets in vocabulary.MODEL_PRESETS.values() for preset in presets} == set(
        vocabulary.PRESETS
    )


def test_presets_have_settings_for_the_models_that_they_belong_to():
    assert list(PRESETS) == list(vocabulary.PRESETS)
    for name, preset in PRESETS.items():
        assert (preset.traced is not None) == (name in vocabulary.MODEL_PRESETS["traced"])
        assert name in vocabulary.MODEL_PRESETS["field"] and preset.field


def test_components_are_found_by_name_and_key():
    for component in vocabulary.COMPONENTS:
        assert vocabulary.component(component.name) == vocabulary.component(component.key) == component
    with pytest.raises(KeyError):
        vocabulary.component("sheen")


def test_menu_texts_have_no_full_stop():
    labels = [*vocabulary.PRESETS.values(), *vocabulary.MODELS.values(), *vocabulary.DEVICES.values()]
    texts = [each.explanation for each in [*labels, *vocabulary.FORMATS.values(), *vocabulary.COMPONENTS]]
    assert all(text and not text.endswith(".") for text in texts), "Blender adds it"


# --- the command line -------------------------------------------------------------------------------


def test_the_backend_parses_what_the_add_on_asks_for():
    request = Request(Path("scene"), Path("out"))
    call = cli.parse(request.arguments())
    options = call.options
    assert (call.command, options.scene, options.out, call.json) == (
        "recover",
        request.scene,
        request.out,
        True,
    )
    assert (options.irradiance, options.preset, options.format) == ("traced", "standard", "png")
    assert not (options.texture_size or options.priors or options.unwrap or options.known)
    traced = replace(
        request,
        preset="high",
        texture_size=2048,
        file_format="exr",
        priors=Path("priors"),
        known=(("0.25", "0.5", "grey"), ("0", "1", "#7A7A79")),
        components=("groups", "bounce"),
        left_out=("gloss",),
    )
    options = cli.parse(traced.arguments()).options
    assert (options.preset, options.texture_size, options.format) == ("high", 2048, "exr")
    assert options.priors == Path("priors") and options.known == tuple(
        parse_known_colour(*spot) for spot in traced.known
    )
    assert (options.model, options.leave_out) == (("groups", "bounce"), ("gloss",))
    field = replace(request, model="field", preset="paper", device="cpu", unwrap=True)
    options = cli.parse(field.arguments()).options
    assert (options.irradiance, options.preset, options.device, options.unwrap) == (
        "field",
        "paper",
        "cpu",
        True,
    )


@pytest.mark.parametrize("device", vocabulary.DEVICES)
@pytest.mark.parametrize("file_format", vocabulary.FORMATS)
@pytest.mark.parametrize(
    ("model", "preset"),
    [(model, preset) for model in vocabulary.MODELS for preset in vocabulary.MODEL_PRESETS[model]],
)
def test_every_word_of_the_vocabulary_is_an_option(device, file_format, model, preset):
    components = tuple(COMPONENT_KEYS) if model == "traced" else ()
    request = Request(Path("s"), Path("o"), model, preset, vocabulary.LARGEST_TEXTURE, file_format, device)
    assert cli.parse(replace(request, components=components).arguments()).options.preset == preset


# --- messages ---------------------------------------------------------------------------------------

PLAN = (
    Decision("clusters", "several lights", "held-out photos are 2 dB better", "time"),
    Decision("sun", "none", "", ""),
)


@pytest.mark.parametrize(
    "message",
    [
        Step("lights", 3.0, 16.0),
        Step("optimise", 3.0, 16.0, 0.25, 41.5),
        Expected({"rays": 2.5}, 40.0),
        Expected({}, 40.0, Quality(30.8, 28.3, 34.2)),
        Planned(PLAN),
        Planned(()),
        Done({"photos": 24}, "/out"),
        Done({"plan": []}),
        Done({}, "/out", "Cube"),
        Failed(2, "mesh.obj has no UVs; unwrap it."),
    ],
)
def test_a_message_comes_back(message: Message):
    line = encode(message)
    assert "\n" not in line and decode(line) == message


@pytest.mark.parametrize("line", ["", "{", "[1]", "3", '"stage"', '{"stage": 3}', '{"step": 1}', "[" * 10000])
def test_a_line_that_is_no_message(line):
    assert decode(line) is None


def test_what_a_message_leaves_open_is_left_out():
    assert decode('{"stage": "bake"}') == Step("bake", 0.0, 0.0)
    assert decode('{"stage": "bake", "step": NaN, "total": "3", "loss": true}') == Step("bake", 0.0, 0.0)
    assert decode('{"stage": "error"}') == Failed(1, "")
    assert decode('{"stage": "done", "out": 3, "report": []}') == Done()
    assert decode('{"stage": "expected"}') is None
    assert Step("bake", 3.0, 2.0).fraction == 1.0 and Step("bake", 0.0, 0.0).fraction == 0.0


def test_lines_of_a_plan_that_say_too_little_are_left_out():
    line = {"what": "gloss", "choice": "on", "reason": "all surfaces reflect", "costs": "time"}
    whole = Decision(**line)
    assert read_decisions([line, {"what": "gloss"}, {**line, "reason": 3}, "gloss"]) == (whole,)
    assert read_decisions([{**line, "costs": None}]) == (replace(whole, costs=""),)
    assert read_decisions(None) == read_decisions({"what": "gloss"}) == ()


def test_expected_without_what_was_reached():
    quality = {"mean": 1.0, "lowest": 0.0}
    assert read_expected({"total_seconds": 2, "albedo_psnr_after_gain": quality}) == Expected({}, 2.0)
    assert read_expected({"total_seconds": None}) is read_expected(None) is None
    assert read_expected({"total_seconds": 1.0, "seconds": {"bake": "x", "rays": 1}}) == Expected(
        {"rays": 1.0}, 1.0
    )


# --- reports and meshes -------------------------------------------------------------------------------


def test_a_report_of_version_0_1_0_is_read():
    old = json.loads((ROOT / "backend/tests/old_report.json").read_text("utf-8"))
    found = report.summary(old)
    assert (found.held_out_psnr, found.texture_size) == (pytest.approx(26.4989, abs=1e-4), 512)
    assert (found.coverage, found.seconds) == (pytest.approx(0.98758, abs=1e-5), pytest.approx(226.814))
    assert found.expected == Expected(old["expected"]["seconds"], 117.944, Quality(29.6, 27.1, 32.4))
    assert [decision.what for decision in found.plan[-5:]] == COMPONENT_KEYS
    assert [vocabulary.decision_title(decision.what) for decision in found.plan[-5:]] == [
        component.title for component in vocabulary.COMPONENTS
    ]
    assert (found.file_format, found.unwrapped) == ("png", False)
    assert set(old["parts"]) == set(COMPONENT_KEYS)
    assert set(old["seconds"]) <= {"start", *vocabulary.STAGES["traced"]}


def test_a_report_without_anything_is_read():
    nothing = report.Summary(None, None, None, None, None, (), "png", False)
    for content in ({}, {"settings": 3, "seconds": [1], "plan": "x", "texture_size": "8", "coverage": "all"}):
        assert report.summary(content) == nothing


def test_a_folder_without_a_report_is_no_result(tmp_path):
    with pytest.raises(OSError):
        report.read_report(tmp_path)
    for content in ("[1]", "{"):
        (tmp_path / report.REPORT).write_text(content)
        with pytest.raises(ValueError):
            report.read_report(tmp_path)


def test_a_mesh_comes_back_to_the_bit_on_both_sides(tmp_path):
    random = np.random.default_rng(0)
    uvs, corners = random.random((5, 2)), random.integers(0, 6, (4, 3))
    mesh = Triangles(1e7 * random.normal(size=(6, 3)), corners, uvs, random.integers(0, 5, (4, 3)))
    write_obj(tmp_path / "a.obj", mesh)
    read = read_obj(tmp_path / "a.obj")
    for name in ("vertices", "corners", "uvs", "uv_corners"):
        assert np.array_equal(getattr(read, name), getattr(mesh, name))
    general = read_mesh(tmp_path / "a.obj")
    assert np.array_equal(general.vertices, mesh.vertices) and np.array_equal(general.faces, corners)
    assert np.array_equal(general.uvs, uvs[mesh.uv_corners])
