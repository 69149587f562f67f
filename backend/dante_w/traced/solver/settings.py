"""The settings of the solver: its schedule, and those of its stages."""

from __future__ import annotations

from dataclasses import dataclass, field

from dante_w.traced.light_clusters import ReassignmentSettings
from dante_w.traced.solver.albedo_scale import AlbedoScaleSettings
from dante_w.traced.solver.evidence import EvidenceSettings
from dante_w.traced.solver.light_prior import LightPriorSettings
from dante_w.traced.solver.normal_equations import EquationSettings
from dante_w.traced.solver.smoothness_prior import SmoothnessSettings
from dante_w.traced.solver.step_control import StepControlSettings
from dante_w.traced.solver.variable_projection import ProjectionSettings
from dante_w.traced.specular import SpecularSettings


@dataclass(frozen=True)
class SolverSettings:
    """Steps are numbered from 0: first the coarse ones, then the fine ones. Seconds and accuracy of several of these numbers:
    `bench tradeoff`."""

    #: Directions of light in the coarse steps, while photos still change clusters: few cost little.
    coarse_directions: int = 64
    #: Steps with few directions.
    coarse_steps: int = 9
    #: Steps with all directions. Five are as good without albedo priors, but not with them (`bench tradeoff`, `bench gigalit`).
    fine_steps: int = 7
    #: How many of the coarse steps are taken from lights of another fit.
    continued_steps: int = 3
    #: Steps before specular radiance is modelled, which needs an albedo.
    steps_without_specular: int = 2
    #: In place of these steps photos may change clusters; a light is given up if another explains its photos with no more than so
    #: many times their residuals. Early on all explain badly, and photos of two lights that became one do not part again
    #: (`bench gigalit`).
    reassignment_steps: tuple[tuple[int, float], ...] = ((3, 1.1), (5, 1.15), (7, 1.25))
    #: Shading points that a step looks at, drawn anew each time. They set the length scale of the smoothness prior: more lie
    #: closer together, where neighbours say less, and make results worse (`bench tradeoff`).
    points_per_step: int = 2500
    #: Cells along either side of the texture up to which a point counts once. Smaller cells show fewer pixels each and weigh
    #: less, but as many of them say no less about light: they count more in proportion (preset `high`, `bench gigalit`).
    counted_side: int = 256
    #: Photos that must see a point for its albedo to be known, or as many as see any point at most.
    fewest_photos: int = 3
    #: Direct light transport (a fraction of the whole sky) above which a point's albedo may be known.
    least_open: float = 0.02
    #: Log radiance of the first lights, per unit of height of the direction: skies are brighter above. It assumes that +z is up.
    sky_tilt: float = 0.3
    #: Albedo above which bounced light grows no more: physically it is below 1.
    highest_bouncing: float = 0.95
    specular: SpecularSettings = field(default_factory=SpecularSettings)
    reassignment: ReassignmentSettings = field(default_factory=ReassignmentSettings)
    evidence: EvidenceSettings = field(default_factory=EvidenceSettings)
    projection: ProjectionSettings = field(default_factory=ProjectionSettings)
    albedo_scale: AlbedoScaleSettings = field(default_factory=AlbedoScaleSettings)
    smoothness: SmoothnessSettings = field(default_factory=SmoothnessSettings)
    light_prior: LightPriorSettings = field(default_factory=LightPriorSettings)
    equations: EquationSettings = field(default_factory=EquationSettings)
    step_control: StepControlSettings = field(default_factory=StepControlSettings)

    @property
    def steps(self) -> int:
        """Steps of a whole fit."""
        return self.coarse_steps + self.fine_steps


USUAL_SOLVER = SolverSettings()
