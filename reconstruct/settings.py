"""Settings of every stage. What nobody has a reason to change is a constant of the module that uses it.

Lengths are in footprints (the size of one pixel at the object) unless a field says otherwise.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from freeart21.errors import FreeArtError


@dataclass(frozen=True)
class SceneSettings:
    """From images to points, normals and colour features."""

    max_crop_pixels: int = 130_000
    """A larger crop is sampled down by a whole factor, to bound time and memory."""
    min_frames: int = 10
    """Fewer frames give a Failure."""


@dataclass(frozen=True)
class TrackSettings:
    """Dense optical flow chained over short windows, and the supplement's trajectory filters."""

    tracker: str = "dis"
    """One of `reconstruct.trackers`."""
    max_round_trip: float = 1.5
    """Disagreement of forward and backward flow, pixels, at which the confidence is 0.5."""
    visibility_filter: bool = True
    """Drop tracks from where their confidence falls to tau_c (supplement, Trajectory Filtering)."""
    tau_c: float = 0.5
    """Confidence that a visible track exceeds; the paper's. Its released code has 0.7."""
    displacement_filter: bool = True
    """Drop tracks from where they move too far."""
    tau_v: float = 2.0
    """Tracks that move more than mean + tau_v standard deviations are dropped (supplement, Trajectory Filtering)."""
    stride: int = 3
    """Spacing of the tracks' starting points, pixels."""


@dataclass(frozen=True)
class EvidenceSettings:
    """Cost of a pixel under a motion: point-to-plane, free space, silhouette, colour."""

    colour_weight: float = 0.2
    """Weight of colour against depth in registration."""


@dataclass(frozen=True)
class LabelSettings:
    """From costs to part masks."""

    propagation: float = 2.0
    """Weight of the beliefs of other frames; a pixel that has seen the joint move weighs its own log-odds."""
    rounds_of_votes: int = 2
    """Times that all frames are labelled again with the beliefs of all frames about each surface."""


@dataclass(frozen=True)
class PropagationSettings:
    """Propagation from the seed in both time directions: first two free poses, then under the joint."""

    surprise_weight: float = 100.0
    """Weight of the constant-velocity prior on the state, in independent pixels: matters where a part is nearly
    hidden."""
    surprising_cost: float = 1.6
    """A frame that costs more than this times the median is lost: the next one tries the states of the whole range."""
    attempts: int = 3
    """Propagations from distant seeds, at most, while much of each is in doubt; the cheapest is taken."""
    beginnings: int = 3
    """Seeds that are tried for each propagation, at most, until one leads to a joint without doubt."""


@dataclass(frozen=True)
class GapSettings:
    """Joining what came before and after frames in which a part is hidden."""

    shortest_gap: int = 2
    """Frames without the part that can break the chain."""
    jump: float = 5.0
    """A step of the state larger than this times the 90th percentile is a jump."""


@dataclass(frozen=True)
class JointSettings:
    """Joint type and closed forms."""

    type_rule: Literal["residual", "paper"] = "residual"
    """'residual': fit both types and compare; 'paper': rotation amplitude and translation linearity."""
    noise_resistance: bool = True
    """Leave out relative poses further than two standard deviations, and weigh neighbours robustly."""


@dataclass(frozen=True)
class PoseSettings:
    """Joint adjustment of all frames over frame pairs."""

    loops: int = 8
    """Pairs per frame with distant frames of a similar view."""


@dataclass(frozen=True)
class GaussianSettings:
    """The articulated Gaussians and their end-to-end optimisation. The loss weights are the paper's."""

    refine: bool = True
    """False: no Gaussians; geometry alone."""
    blended: bool = True
    """False: part weights stay 0 or 1 (the ablation "w/o Blended Rendering")."""
    end_to_end: bool = True
    """False: poses, states and joint stay as they were (the ablation "w/o end-to-end")."""
    backend: Literal["auto", "numba", "gsplat"] = "auto"
    """Rasteriser: numba on the processor, gsplat on a CUDA GPU, or gsplat where it works."""
    rounds: int = 12
    """Passes over all frames."""
    warm_up: int = 2
    """Passes before the motion is refined, too."""
    most_pixels: int = 60_000
    """Images with a larger foreground are sampled down by a whole factor, to bound time."""
    begin: int = 25_000
    """Gaussians at the start, at most."""
    most: int = 50_000
    """Gaussians, at most."""
    light_terms: int = 16
    """Spherical harmonics of the light: 1 (none), 4, 9, 16 or 25."""
    ssim: float = 0.2
    """lambda_ssim."""
    depth: float = 1.0
    """lambda_depth, of depth in the unit of `reconstruct.gaussians.windows.Windows.depth_unit`."""
    mask: float = 1.0
    """lambda_mask."""
    held_back: int = 10
    """Every n-th frame is held out for validation."""

    def __post_init__(self) -> None:
        terms = (1, 4, 9, 16, 25)  # freeart21.gaussians.LIGHT_TERMS, which would import numpy for `--help`
        bounds = {
            "light_terms": (self.light_terms in terms, f"one of {str(terms)[1:-1]}"),
            "warm_up": (1 <= self.warm_up <= self.rounds, f"1 to {self.rounds}, the rounds"),
            "most_pixels": (self.most_pixels > 0, "more than 0"),
            "begin": (self.begin > 0, "more than 0"),
            "most": (self.most > 0, "more than 0"),
            "held_back": (self.held_back >= 2, "every 2nd frame or fewer"),
        }
        for name, (is_good, expected) in bounds.items():
            if not is_good:
                flag = name.replace("_", "-")
                raise FreeArtError(f"settings.gaussians.{flag} is {getattr(self, name)}, expected {expected}")


@dataclass(frozen=True)
class SurfaceSettings:
    """Fusion of a part's depth into a coloured mesh."""

    voxel: float = 1.0
    """Smallest voxel edge."""


RendersFrom = Literal["gaussians and video", "gaussians", "video"]


@dataclass(frozen=True)
class ReconstructSettings:
    """All stages."""

    seed: int = 0
    poses_from: str = ""
    """SOURCE:FOLDER of the parts' poses that another program found (`reconstruct.pose_sources`): initial guesses beside
    our own."""
    scene: SceneSettings = field(default_factory=SceneSettings)
    tracks: TrackSettings = field(default_factory=TrackSettings)
    evidence: EvidenceSettings = field(default_factory=EvidenceSettings)
    labels: LabelSettings = field(default_factory=LabelSettings)
    growth: PropagationSettings = field(default_factory=PropagationSettings)
    gaps: GapSettings = field(default_factory=GapSettings)
    joint: JointSettings = field(default_factory=JointSettings)
    poses: PoseSettings = field(default_factory=PoseSettings)
    gaussians: GaussianSettings = field(default_factory=GaussianSettings)
    surfaces: SurfaceSettings = field(default_factory=SurfaceSettings)
    renders: RendersFrom = "gaussians and video"
    """Source of held-out views: the Gaussians plus what the video shows beyond them, the Gaussians alone, or the
    video's pixels on the fused meshes."""
    progress: bool = True
    """Show a progress bar on standard error."""

    def to_json(self) -> dict[str, Any]:
        """All settings as plain data, to be saved with a result."""
        return asdict(self)


def read_settings(path: Path) -> ReconstructSettings:
    """Settings from JSON: as written by `to_json`, or the `settings` of a method.json or prediction.json.

    Settings that the file does not name keep their defaults. FreeArtError names a setting that does not exist, or a
    value of another type. Settings of a saved result that this version does not have are ignored.
    """
    from freeart21.files import checked
    from freeart21.files.json_record import read_record

    path = Path(path)
    data = checked.read_json(path, root=checked.ANYWHERE)
    saved = "schema" in data and isinstance(data.get("settings"), dict)
    return read_record(ReconstructSettings, data["settings"] if saved else data, f"{path}: settings", whole=saved)
