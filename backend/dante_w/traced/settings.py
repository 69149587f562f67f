"""All numbers of traced light in one place: each stage's settings stand beside the stage, this gathers them."""

from __future__ import annotations

from dataclasses import dataclass

from dante_w.traced.albedo_prior import USUAL_PRIORS, AlbedoPriorSettings
from dante_w.traced.albedo_texture import USUAL_ALBEDO, AlbedoSettings
from dante_w.traced.light_clusters import USUAL_CLUSTERS, ClusterSettings
from dante_w.traced.light_transport import USUAL_TRANSPORT, TransportSettings
from dante_w.traced.model_selection import USUAL_SELECTION, SelectionSettings
from dante_w.traced.shading_points import USUAL_SHADING, ShadingSettings
from dante_w.traced.solver.settings import USUAL_SOLVER, SolverSettings
from dante_w.traced.sun import USUAL_SUN, SunSettings


@dataclass(frozen=True)
class TracedSettings:
    """Settings of traced light; the defaults are the preset `standard`.

    Attributes:
        directions: that light comes from. Fewer lose the shadows' edges, more cost time (squared) and bring nothing
            (`bench tradeoff`).
        left_out: components that the preset leaves out, by name.
        goes_on: whether the lights go on from those that the plan has found: faster, and less accurate.
        shading, transport, prior, clusters, selection, solver, sun, albedo: of the stages of those names.
    """

    directions: int = 256
    left_out: tuple[str, ...] = ()
    goes_on: bool = False
    shading: ShadingSettings = USUAL_SHADING
    transport: TransportSettings = USUAL_TRANSPORT
    prior: AlbedoPriorSettings = USUAL_PRIORS
    clusters: ClusterSettings = USUAL_CLUSTERS
    selection: SelectionSettings = USUAL_SELECTION
    solver: SolverSettings = USUAL_SOLVER
    sun: SunSettings = USUAL_SUN
    albedo: AlbedoSettings = USUAL_ALBEDO
