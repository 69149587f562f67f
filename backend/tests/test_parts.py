"""The plan: what held-out photos ask for is modelled, and nothing else; what the user says stands."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from dante_w.contract.protocol import Decision
from dante_w.scene.held_out import choose_held_out
from dante_w.traced.light_clusters import first_clusters
from dante_w.traced.model_selection import TRIED, USUAL_SELECTION, Fixed, SelectionSettings, select_components
from dante_w.traced.solver.settings import SolverSettings
from dante_w.traced.state import Components, TracedScene
from open_world import PHOTOS, POINTS, World, make_world

BOUNCED = USUAL_SELECTION.bounced


SOLVER = SolverSettings(coarse_directions=32)


def planned(
    world: World, settings: SelectionSettings = USUAL_SELECTION, **chosen: bool
) -> tuple[Components, dict[str, Decision]]:
    said: list[float] = []
    clusters = first_clusters(world.observations, len(world.points), len(world.cameras))
    selection = select_components(
        TracedScene(world.cameras, world.points, world.observations, world.transport, None, None, clusters),
        {name: Fixed(on) for name, on in chosen.items()},
        0,
        lambda done, total: said.append(done / total),
        settings,
        SOLVER,
    )
    parts, decisions, begun = selection.components, selection.decisions, selection.lighting
    assert said == sorted(said) and said[-1] == 1.0
    tried = len(choose_held_out(len(world.cameras))) and not set(TRIED) <= set(chosen)
    assert (begun is not None) == bool(tried)
    if begun:
        assert (len(begun.radiance) > 1) == parts.clusters or chosen.get("clusters")
        assert len(begun.radiance) <= len(world.cameras)
    assert [decision.what for decision in decisions] == list(vars(Components()))
    assert all(decision.choice and decision.reason and decision.costs for decision in decisions)
    return parts, {decision.what: decision for decision in decisions}


@pytest.mark.parametrize(("lights", "exposures"), [(1, 0.0), (1, 0.35), (3, 0.0), (3, 0.35)])
def test_what_photos_differ_in_is_modelled(lights, exposures):
    parts, said = planned(make_world(lights, exposures, matte=True), specular=False)
    assert (parts.clusters, parts.exposures) == (lights > 1, exposures > 0.0)
    assert said["clusters"].choice == ("several lights" if lights > 1 else "one light")
    assert said["exposures"].choice == ("one for each photo" if exposures else "one for all photos")
    for part in ("clusters", "exposures"):
        assert "dB" in said[part].reason and "nan" not in said[part].reason
    assert not parts.bounce and said["bounce"].reason.startswith("0%")


def test_exposures_are_tried_without_gloss_that_is_not_there():
    parts, _ = planned(make_world(1, 0.0, matte=True))
    assert not (parts.clusters or parts.specular or parts.exposures)


@pytest.mark.parametrize("matte", [False, True])
def test_under_one_light_held_out_photos_tell_gloss(matte):
    parts, said = planned(make_world(1, 0.35, matte=matte))
    assert not parts.clusters and parts.specular != matte
    assert "dB" in said["specular"].reason
    assert planned(make_world(1, 0.35, matte=matte), specular=matte)[0].specular == matte


@pytest.mark.parametrize("matte", [False, True])
def test_under_several_lights_gloss_is_modelled_unless_photos_are_far_worse_with_it(matte):
    parts, said = planned(make_world(3, 0.35, matte=matte))
    assert parts.clusters
    assert parts.specular != matte
    assert "dB" in said["specular"].reason


def test_under_several_lights_gloss_stays_where_photos_hardly_tell():
    patient = SelectionSettings(specular_of_several=-100.0)
    parts, said = planned(make_world(3, 0.35, matte=True), patient)
    assert parts.clusters
    assert parts.specular
    assert "it stays on, although" in said["specular"].reason and "-" in said["specular"].reason


def test_what_the_user_says_stands():
    one, many = make_world(1, 0.0), make_world(3, 0.35)
    parts, said = planned(one, clusters=True, exposures=True, bounce=True)
    assert dataclasses.replace(parts, sun=True) == Components()
    parts, _ = planned(many, clusters=False, specular=False)
    assert dataclasses.replace(parts, sun=False) == Components(
        False, exposures=True, bounce=False, specular=False, sun=False
    )
    assert {name for name, each in said.items() if each.reason == "you chose it"} == {
        "clusters",
        "exposures",
        "bounce",
    }


@pytest.mark.parametrize("share", [0.5 * BOUNCED, 2.0 * BOUNCED])
def test_light_from_the_mesh_counts_from_a_share_on(share):
    world = make_world(1, 0.0)
    lost = np.full(POINTS, share, np.float32)
    world = dataclasses.replace(world, transport=dataclasses.replace(world.transport, lost=lost))
    assert planned(world, clusters=False, exposures=False)[0].bounce == (share > BOUNCED)


def test_too_few_photos_to_try_anything():
    world = make_world()
    few = dataclasses.replace(
        world, cameras=world.cameras[:4], observations=world.observations.take(world.observations.photo < 4)
    )
    parts, said = planned(few)
    assert parts.clusters and parts.exposures
    assert said["clusters"].reason == said["exposures"].reason == "too few photos to check"


def test_held_out_photos_that_show_nothing():
    """The ones that are held out of 18 photos are all clipped."""
    world = make_world()
    clipped = np.isin(world.observations.photo, [4, 13])
    parts, said = planned(
        dataclasses.replace(world, observations=dataclasses.replace(world.observations, clipped=clipped))
    )
    assert PHOTOS == 18 and parts.clusters and parts.exposures
    assert said["clusters"].reason == "too few photos to check"
