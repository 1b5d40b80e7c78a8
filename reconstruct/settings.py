"""Settings of every stage. Lengths are in footprints (the size of one pixel at the object) unless a field says so."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from freeart21.errors import FreeArtError

_Settings = TypeVar("_Settings")
_KINDS = {int: "a whole number", float: "a number", bool: "true or false", str: "text"}


@dataclass(frozen=True)
class SceneSettings:
    """From pictures to points, normals and colour features."""

    margin: int = 12
    """Pixels kept round the object's box."""
    max_crop_pixels: int = 130_000
    """A larger crop is sampled down by a whole factor, to bound time and memory."""
    plane_radius: int = 2
    """Half window, pixels, of the local plane fit; grows with depth noise."""
    depth_jump: float = 4.0
    """Depth step that parts two surfaces."""
    min_frames: int = 10
    """Fewer frames are hopeless: a Failure."""
    min_pixels: int = 60
    """Foreground pixels with depth that a frame needs to count."""


@dataclass(frozen=True)
class TrackSettings:
    """Dense optical flow chained over short windows, and the supplement's trajectory filters."""

    max_round_trip: float = 1.5
    """Pixels by which forward and backward flow disagree where the confidence is 0.5."""
    visibility_filter: bool = True
    """Drop tracks from where their confidence falls to tau_c (supplement, Trajectory Filtering)."""
    tau_c: float = 0.5
    """Confidence that a visible track exceeds; the paper's. Its released code has 0.7."""
    displacement_filter: bool = True
    """Drop tracks from where they move too far."""
    tau_v: float = 2.0
    """Tracks that move more than mean + tau_v standard deviations are dropped (supplement, Trajectory Filtering)."""
    stride: int = 3
    """Every how many pixels, both ways, a track starts."""


@dataclass(frozen=True)
class SeedSettings:
    """Where two motions explain a window far better than one."""

    every: int = 6
    """Frames between candidate windows."""
    gaps: tuple[int, ...] = (3, 6, 12)
    """Frame distances over which two rigid motions are sought in the tracks."""
    hypotheses: int = 120
    """RANSAC samples per window, each from a small neighbourhood."""
    neighbourhood: float = 0.2
    """Radius of that neighbourhood, in object diagonals."""
    sample: int = 8
    """Tracks per RANSAC sample."""
    max_tracks: int = 1200
    em_rounds: int = 4
    """EM rounds of the pair of transforms (supplement, Transformation Initialization)."""
    stretch: int = 12
    """Frames of which the window with the best tracks, of each gap, is tried on all pixels of its two frames."""
    refined: int = 12
    """Windows whose motions are refined on all their frames before the best is chosen."""
    window: int = 6
    """Frames, each way, of the dense refinement."""
    min_gain: float = 0.03
    """Least drop of the dense cost from one motion to two; below it nothing moves against anything else: a Failure."""
    min_share: float = 0.04
    """Least share of the foreground that the smaller part has in the seed frame."""


@dataclass(frozen=True)
class EvidenceSettings:
    """What one pixel says about a motion: point-to-plane, free space, silhouette, colour."""

    sigma: float = 0.8
    """Standard deviation of point-to-plane residuals of a clean sensor; noise that planes leave adds in quadrature."""
    sigma_colour: float = 3.0
    """Standard deviation of colour residuals, CIELAB units."""
    sigma_silhouette: float = 2.0
    """Standard deviation, pixels, of points outside the mask."""
    colour_weight: float = 0.2
    """Weight of colour against depth in registration."""
    cap: float = 6.0
    """Largest cost of a pixel."""
    enough_pixels: int = 60
    """With fewer pixels of a part away from depth steps, those at depth steps are used too."""


@dataclass(frozen=True)
class LabelSettings:
    """From evidence to part masks, over neighbours that look alike and lie in one plane: a random walk (Grady 2006); in
    the seed, a mean-field relaxation."""

    smoothness: float = 0.5
    """Pull of one neighbour of the same look, in log-odds."""
    rounds: int = 10
    propagation: float = 2.0
    """Pull of what other frames believe, where a pixel that has seen the joint move pulls with its log-odds."""
    reach: float = 0.12
    """Distance, in object diagonals, over which neighbours pull."""
    references: int = 10
    """Frames that each frame is compared with."""
    dense_pixels: int = 12_000
    """A larger foreground is measured at every other pixel only."""
    walk: float = 8.0
    """Pull of one neighbour of the same look in the random walk, where a pixel that knows pulls with its log-odds."""
    residual: float = 3e-3
    """Share of the residual of what pixels see and hear, unsmoothed, at which the random walk is solved."""
    rounds_of_votes: int = 2
    """Times that all frames are labelled again, each hearing what all others believe of its surfaces."""
    vote: float = 20.0
    """Pull of what all frames believe of a surface, where a pixel that has seen the joint move pulls with its
    log-odds."""
    vote_cell: float = 3.0
    """Size, in units, of the cells of a surface in which beliefs are gathered."""
    doubt: float = 0.03
    """Pull to not knowing: how soon belief fades away from those who know."""
    max_turn: float = 1.2
    """Radians between two views that are compared."""
    least_apart: float = 0.02
    """Object diagonals that the second part has moved, at least, between frames that tell the motions apart."""
    neighbours: tuple[int, ...] = (-12, -6, -3, -1, 1, 3, 6, 12)
    """Frame distances over which labels are passed on."""
    similar: int = 5
    """More distant frames, of the most similar view, that pass their labels on."""


@dataclass(frozen=True)
class GrowthSettings:
    """Growing from the seed, both ways in time: first free, then with the joint."""

    samples: int = 600
    """Pixels of a part in a reference frame that take part in registration."""
    references: int = 6
    """Reference frames per registration."""
    max_turn_deg: float = 50.0
    """Furthest view change to a reference frame."""
    gates: tuple[float, ...] = (18.0, 13.0, 9.0, 6.0, 5.0, 4.0)
    """Point-to-plane gates of the registration, coarse to fine."""
    min_part_pixels: int = 60
    """Fewer pixels of a part do not fix its pose when it moves freely."""
    min_jointed_pixels: int = 12
    """Fewer pixels of a part say nothing of its state when the joint is known."""
    state_surprise: float = 0.05
    """How far a state may stray from even motion in one frame: radians, or object diagonals."""
    surprise_weight: float = 100.0
    """Weight of that prior, as a number of independent pixels: it only counts where a part is nearly hidden."""
    rest_cost: float = 1.02
    """The joint is taken to rest in a frame that costs no more than so many times what it costs with a motion."""
    rest_cost_freely: float = 1.12
    """The same where labels say little, and pixels are free to choose their part: that fits noise as well."""
    surprising_cost: float = 1.6
    """A frame that costs so many times the usual is lost: the states of the whole range are tried in the next."""
    searched_states: int = 41
    found_cost: float = 0.75
    """Share of the cost of going on evenly below which a state found so is believed."""
    look_back: int = 8
    """Nearer frames are not asked for it if others are there."""
    agreeing: float = 5.0
    """Growing back from where a part was found again ends where old and new poses differ by less: widened footprints"""
    agreeing_frames: int = 3
    """in so many frames on end."""
    sound_frames: int = 8
    """A part had been lost after the last so many frames on end with"""
    sound_share: float = 0.05
    """at least this share of sure pixels of either part, and few in doubt."""
    doubtful: float = 0.1
    """A frame with a larger share of pixels in doubt is labelled anew when the joint is adjusted."""
    doubtful_most: int = 40
    """Frames that are so labelled anew each time, at most: those most in doubt."""
    bootstrap_frames: int = 18
    """Frames grown freely before a joint is tried."""
    bootstrap_motion: float = 0.12
    """Relative displacement of the moving part, in object diagonals, that makes a joint worth trying."""
    bootstrap_most: int = 48
    """The joint is tried after so many frames in any case."""
    attempts: int = 3
    """Growths from seeds far apart, at most, as long as much of each is in doubt: the cheapest stays."""
    beginnings: int = 3
    """Seeds that growth begins from, at most, until one leads to a joint without doubt;"""
    beginnings_apart: int = 20
    """they lie as many frames apart, at least."""
    sure_cost: float = 0.15
    """Mean cost of a beginning's frames under its joint below which no other is tried."""
    adjust_every: int = 16
    """Frames between joint adjustments while growing."""
    adjust_samples: int = 250
    """Pixels per frame and part of these adjustments."""
    same_place: float = 0.2
    """A frame whose pose changes by less, in widened footprints, once it is labelled, keeps its labels."""


@dataclass(frozen=True)
class PieceSettings:
    """Growing anew, from seeds of their own, where growth was lost for long."""

    most: int = 3
    """Stretches that are tried, at most."""
    lost_cost: float = 2.5
    """A frame that costs so many times the usual shows that growth was lost."""
    doubtful: float = 0.15
    """Share of frames that cost so much against the best quarter at which a whole growth is in doubt."""
    shortest: int = 8
    """Fewer such frames on end are left as they are."""
    margin: int = 40
    """Frames beyond a stretch, both ways, that its piece grows over: there it is joined."""
    better: float = 0.85
    """Share of the present cost below which what a piece found is believed."""


@dataclass(frozen=True)
class FeatureSettings:
    """Hand-made features: by how much a cue must differ to count as one unit of distance; 0 leaves the cue out."""

    colour: float = 10.0
    """CIELAB units, lightness damped."""
    gradient: float = 10.0
    """Grey levels a pixel."""
    place: float = 0.1
    """Object diagonals."""
    normal: float = 0.7
    """Length of the difference of two unit normals."""
    curvature: float = 0.2
    """0 on a plane, towards 1 where normals differ."""


@dataclass(frozen=True)
class PaperSegmentationSettings:
    """The paper's free-moving part segmentation. Lengths are in half object diagonals: the paper's objects, and with
    them its learning rates, are of about 2 m. Numbers are the paper's where it has any."""

    window: int = 8
    """Frames of a window; pairs are (0, i) with i up to window - 1."""
    iterations: int = 100
    """Steps of Adam a pair."""
    rate_transform: float = 1e-4
    """Adam's learning rate of the transforms' twists."""
    rate_weight: float = 1e-2
    """Adam's learning rate of the part weights."""
    use_main: bool = True
    main: float = 200.0
    """lambda_m of L_main."""
    use_smoothness: bool = True
    """False: the ablation "w/o Smooth Loss"."""
    smoothness: float = 10.0
    """lambda_s of L_smooth."""
    use_entropy: bool = True
    entropy: float = 0.01
    """lambda_e of L_ent. The released code has -0.01, of a term of the other sign."""
    use_init: bool = True
    """False: the ablation "w/o Init Loss"."""
    init: float = 5.0
    """lambda_init of L_init. The released code has 20."""
    huber: float = 1.0
    """Where rho turns from square to linear, as a share of the displacement (the paper does not say)."""
    epsilon: float = 1e-3
    """The constant in L_main's denominator (the paper does not say)."""
    clusters: int = 2
    """Feature clusters of the first window. More than two vote on the motion that carries them (the paper does not
    say how many)."""
    second_from_outliers: bool = True
    """Where both clusters found one and the same motion, the second is sought among what the first does not explain.
    Not in the paper, whose learned features part the parts better."""
    em_rounds: int = 5
    """EM rounds of the initial transforms."""
    tukey: float = 5.0
    """Cut-off of Tukey's weight, in widened footprints (the paper does not say)."""
    radius: float = 1.0
    """Radius of the neighbour graph in feature space (the paper does not say)."""
    neighbours: int = 12
    """Nearest neighbours within the radius that are kept, to bound time."""
    fill_neighbours: int = 16
    """Tracks, nearest in features, whose weights fill a pixel; 0 takes all, as the formula reads."""
    max_tracks: int = 1500
    """Tracks of a window, to bound time."""
    min_tracks: int = 60
    """A pair with fewer tracks is not solved: its weights and motions are those of the pair before."""
    relabel: bool = False
    """Let the joint stage label anew from dense evidence, as ours does: then the masks are no longer the paper's."""


@dataclass(frozen=True)
class GapSettings:
    """Joining what came before and after frames in which a part is hidden."""

    shortest_gap: int = 2
    """Frames without the part that can break the chain."""
    shortest_piece: int = 5
    """Shorter runs between two gaps are not believed."""
    jump: float = 5.0
    """A state that changes at once by so many times the usual has jumped."""
    frames: int = 10
    """Frames, evenly drawn on each side, that are compared."""
    samples: int = 200
    """Pixels of the part per frame."""
    steps: int = 40
    """Steps of the state, each way, over the range of motion."""
    least_gain: float = 0.05
    """Share by which the cost must fall for the states to be shifted."""
    foreign: float = 1.25
    """A stretch that costs so many times what the others cost among themselves fits nowhere."""
    hidden_states: int = 61
    """States that are tried in frames in which a part is hidden."""
    evenness: float = 20.0
    """Weight of squared steps off even motion, in ranges, against the mean cost of pixels that would stick out."""


@dataclass(frozen=True)
class ExchangeSettings:
    """Turning back stretches in which the parts were taken for each other."""

    every: int = 4
    """Frames between those that are compared, and between the cuts that are tried at first."""
    suspicion: float = 0.05
    """All cuts are tried if one of these makes the cost fall by this share."""
    samples: int = 120
    """Pixels of a part per frame."""
    references: int = 3
    """Frames on the other side of a cut that a frame is compared with."""
    max_turn: float = 0.7
    """Radians between two views that are compared."""
    least_views: int = 6
    """Frames that have such views on the other side of a cut; with fewer nothing is said of it."""
    least_gain: float = 0.1
    """Share by which the cost must fall for the parts to be exchanged."""
    most: int = 4
    """Exchanges at most."""


@dataclass(frozen=True)
class JointSettings:
    """Joint type and closed forms."""

    type_rule: Literal["residual", "paper"] = "residual"
    """'residual': fit both types to the end and compare; 'paper': rotation amplitude and translation linearity."""
    noise_resistance: bool = True
    """Leave out relative poses further than two standard deviations, and weigh neighbours robustly."""
    rotation_threshold_deg: float = 10.0
    """theta_th of the paper's rule."""
    linearity_threshold: float = 0.05
    """rho_th of the paper's rule."""
    revolute_cost: float = 0.9
    """Share of the prismatic cost, all evidence adjusted under either type, below which a revolute joint, with two
    unknowns more, is chosen."""
    beyond_doubt: float = 0.4
    """At the end the other type is not tried again when the poses, free of any joint, fit this one so much better."""
    farthest_hinge: float = 2.0
    """Object diagonals from the moving part within which a hinge is believed."""


@dataclass(frozen=True)
class PoseSettings:
    """Adjustment of all frames over pairs: no frame is anchored."""

    offsets: tuple[int, ...] = (1, 2, 4, 7, 11)
    """Frame distances of pairs along time."""
    loops: int = 8
    """Pairs per frame with distant frames of a similar view."""
    samples: int = 500
    """Pixels per frame and part."""
    gate: float = 9.0
    """First point-to-plane gate; shrinks to `final_gate`."""
    final_gate: float = 4.0
    joint_rounds: int = 14
    """Iterations of the joint-constrained adjustment."""
    free_rounds: int = 8
    """Iterations of the adjustment that knows no joint."""


@dataclass(frozen=True)
class GaussianSettings:
    """The articulated Gaussians and their end-to-end optimisation. Weights of the losses are the paper's; rates are
    those of 3D Gaussian splatting, for a tenth of its iterations."""

    refine: bool = True
    """False: no Gaussians; geometry alone."""
    blended: bool = True
    """False: part weights stay 0 or 1 (the ablation "w/o Blended Rendering")."""
    end_to_end: bool = True
    """False: poses, states and joint stay as they were (the ablation "w/o end-to-end")."""
    backend: Literal["auto", "numba", "gsplat"] = "auto"
    """What draws: numba on the processor, gsplat on a CUDA GPU, or gsplat where it works."""
    rounds: int = 12
    """Times that all frames are looked at."""
    warm_up: int = 2
    """Of them, those before the motion is refined, too."""
    most_pixels: int = 60_000
    """Pictures with a larger foreground are sampled down by a whole factor, to bound time."""
    begin: int = 25_000
    """Gaussians at the beginning, at most."""
    most: int = 50_000
    """Gaussians, at most."""
    spacing: float = 1.0
    """Distance between them at the beginning."""
    light_terms: int = 16
    """Spherical harmonics of the light: 1 (none), 4, 9, 16 or 25."""
    sure: float = 0.97
    """Part weight at the beginning of what the segmentation gave to the reference part."""
    ssim: float = 0.2
    """lambda_ssim."""
    depth: float = 1.0
    """lambda_depth, of depth in half object diagonals (the paper's objects are of about 2 m) or, of exact sensors, as
    many standard deviations as colour has (`reconstruct.gaussians.windows.Windows.depth_unit`)."""
    mask: float = 1.0
    """lambda_mask."""
    held_back: int = 10
    """Every how many frames one is held back, to judge by."""
    cells: int = 8000
    """Patches of the surface, which the adjustment lets shift."""
    momentum: float = 0.5
    """Share of the last step of poses and joint that is taken again (half of it in the last third of the rounds): model
    and motion wait for each other."""
    rate_means: float = 0.05
    """Adam's learning rate of the means, footprints."""
    rate_quaternions: float = 1e-3
    rate_scales: float = 5e-3
    """Of the logarithms of the scales."""
    rate_opacities: float = 5e-2
    """Of their logits."""
    rate_colours: float = 5e-3
    rate_weights: float = 5e-2
    """Of the logits of the part weights."""
    rate_light: float = 5e-3
    last_rate: float = 0.1
    """Share of the rates that is left at the end."""

    def __post_init__(self) -> None:
        terms = (1, 4, 9, 16, 25)  # freeart21.gaussians.LIGHT_TERMS, which would import numpy for `--help`
        if self.light_terms not in terms:
            raise FreeArtError(
                f"settings.gaussians.light-terms is {self.light_terms}, expected one of {str(terms)[1:-1]}"
            )
        if not 1 <= self.warm_up <= self.rounds:
            raise FreeArtError(
                f"settings.gaussians.warm-up is {self.warm_up} of {self.rounds} rounds, expected 1 to {self.rounds}"
            )
        for name in ("most_pixels", "begin", "most", "spacing", "cells"):
            if not getattr(self, name) > 0:
                flag = name.replace("_", "-")
                raise FreeArtError(f"settings.gaussians.{flag} is {getattr(self, name)}, expected more than 0")
        if self.held_back < 2:
            raise FreeArtError(f"settings.gaussians.held-back is {self.held_back}, expected every 2nd frame or fewer")


@dataclass(frozen=True)
class SurfaceSettings:
    """Fusion of a part's depth into a coloured mesh."""

    voxel: float = 1.0
    """Least edge of a voxel."""
    max_voxels: int = 16_000_000
    """In the box round a part, most of them far from any surface and never looked at."""
    truncation: float = 3.0
    """Voxels in front of the surface over which a depth measurement tells distance."""
    behind: float = 2.0
    """Voxels behind the surface of which it speaks at all: sheets thinner than this grow thicker."""
    max_frames: int = 80
    """Frames that are fused, evenly drawn."""
    min_component: float = 0.1
    """Pieces smaller than this share of the largest are dropped."""
    sharpness: float = 6.0
    """Power of a view's quality (frontal, near) in the mean colour: high lets the best views win."""


RendersFrom = Literal["gaussians and video", "gaussians", "video"]


@dataclass(frozen=True)
class ReconstructSettings:
    """All stages."""

    seed: int = 0
    segmentation: Literal["ours", "paper"] = "ours"
    """Whose part segmentation: ours, or the paper's with features made by hand."""
    scene: SceneSettings = field(default_factory=SceneSettings)
    tracks: TrackSettings = field(default_factory=TrackSettings)
    seeds: SeedSettings = field(default_factory=SeedSettings)
    evidence: EvidenceSettings = field(default_factory=EvidenceSettings)
    labels: LabelSettings = field(default_factory=LabelSettings)
    growth: GrowthSettings = field(default_factory=GrowthSettings)
    pieces: PieceSettings = field(default_factory=PieceSettings)
    features: FeatureSettings = field(default_factory=FeatureSettings)
    paper: PaperSegmentationSettings = field(default_factory=PaperSegmentationSettings)
    exchanges: ExchangeSettings = field(default_factory=ExchangeSettings)
    gaps: GapSettings = field(default_factory=GapSettings)
    joint: JointSettings = field(default_factory=JointSettings)
    poses: PoseSettings = field(default_factory=PoseSettings)
    gaussians: GaussianSettings = field(default_factory=GaussianSettings)
    surfaces: SurfaceSettings = field(default_factory=SurfaceSettings)
    renders: RendersFrom = "gaussians and video"
    """What held-out views are made of: the Gaussians and what the video shows beyond them, the Gaussians alone, or the
    video's pixels on the fused meshes."""
    progress: bool = True
    """Show a progress bar on standard error."""

    def to_json(self) -> dict[str, Any]:
        """All settings as plain data, to be saved with a result."""
        return asdict(self)


def read_settings(path: Path) -> ReconstructSettings:
    """Settings from JSON: as `to_json` says them, or the `settings` of a method.json or prediction.json.

    What the file does not name keeps its default. FreeArtError names a setting that does not exist, or a value of
    another type.
    """
    from freeart21.files import checked

    data = checked.read_json(Path(path), root=checked.ANYWHERE)
    if "schema" in data and isinstance(data.get("settings"), dict):
        data = {name: value for name, value in data["settings"].items() if name != "solver"}
    return _filled(ReconstructSettings(), data, Path(path), "")


def _filled(settings: _Settings, data: dict[str, Any], path: Path, within: str) -> _Settings:
    """`settings` with what `data` says of them."""
    assert is_dataclass(settings) and not isinstance(settings, type)
    kinds, known = get_type_hints(type(settings)), [f.name for f in fields(settings)]
    changed: dict[str, Any] = {}
    for name, value in data.items():
        if name not in known:
            raise FreeArtError(
                f"{path}: there is no setting '{within}{name}'; {within or 'settings'}: {', '.join(known)}"
            )
        now = getattr(settings, name)
        if is_dataclass(now):
            if not isinstance(value, dict):
                raise FreeArtError(f"{path}: setting '{within}{name}' is {value!r}, expected an object")
            changed[name] = _filled(now, value, path, f"{within}{name}.")
        else:
            changed[name] = _checked(kinds[name], value, f"{path}: setting '{within}{name}'")
    return replace(settings, **changed)


def _checked(kind: Any, value: Any, what: str) -> Any:
    """`value` as a setting of the type `kind`."""
    if get_origin(kind) is Literal:
        if value in get_args(kind):
            return value
        raise FreeArtError(f"{what} is {value!r}, expected {' or '.join(map(str, get_args(kind)))}")
    if get_origin(kind) is tuple and isinstance(value, list):
        return tuple(_checked(get_args(kind)[0], entry, what) for entry in value)
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if kind is float and number:
        return float(value)
    if kind in (int, bool, str) and type(value) is kind:
        return value
    raise FreeArtError(f"{what} is {value!r}, expected {_KINDS.get(kind, 'a list of numbers')}")
