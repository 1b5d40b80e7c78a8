"""Named protocols: what each number means, in which unit, which way is better, and what a failure costs.

A protocol's text never changes: a changed definition is a new protocol with a new name.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from freeart21.errors import FreeArtError
from freeart21.joint import JointType
from leaderboard import strict1, strict2
from leaderboard.strict1 import Measured

Group = Literal["revolute", "prismatic", "all"]


@dataclass(frozen=True)
class Metric:
    """One number of a protocol."""

    id: str
    revolute_unit: str | None
    """Unit for objects whose true joint is revolute; None where the number does not exist."""
    prismatic_unit: str | None
    """Unit for objects whose true joint is prismatic; None where the number does not exist."""
    direction: Literal["up", "down"]
    """'up': larger is better."""
    price: float | None
    """What a failure, a missing sequence or (where it applies) a wrong joint type costs; None: the range of motion."""
    definition: str
    beside: str | None = None
    """The ranking number beside which this one is shown; None when it is a ranking number itself."""
    label: str = ""
    """Its name for people, such as 'chamfer, moving part'."""
    column: str = ""
    """The head of its column where tables have room for few; empty: left out there."""

    def unit(self, group: Group) -> str | None:
        """The unit in a group of sequences; None where there is none, or no common one."""
        if group == "revolute":
            return self.revolute_unit
        if group == "prismatic":
            return self.prismatic_unit
        if None in (self.revolute_unit, self.prismatic_unit):
            return self.revolute_unit or self.prismatic_unit
        return self.revolute_unit if self.revolute_unit == self.prismatic_unit else None

    def price_for(self, joint_type: JointType, range_of_motion: float) -> float | None:
        """The price for a sequence, in the metric's unit; `range_of_motion` in the unit of `state`."""
        if self.unit(joint_type) is None:
            return None
        return range_of_motion if self.price is None else self.price


@dataclass(frozen=True)
class Protocol:
    """A named, versioned set of metrics."""

    name: str
    preamble: str
    """How parts are matched, poses aligned, lengths scaled, failures counted."""
    metrics: tuple[Metric, ...]
    measure: Callable[..., Measured]
    """`measure(truth, answer, renders)`, see `leaderboard.strict1.measure`: values in the units of the metrics. With
    `whole_asset` also `asset` and `renders_other`, see `leaderboard.strict2.measure`."""
    whole_asset: bool = False
    """Whether an asset's meshes and masses count, not its joint alone; and views under both choices of the parts."""
    capped: bool = False
    """Whether a price is a cap, so that no answer costs more than a declared failure."""

    def capped_value(self, id: str, value: float, price: float) -> float:
        """`value` of the metric `id`, or its price where the protocol caps it and the value is worse."""
        if not self.capped:
            return value
        return min(value, price) if self.metric(id).direction == "down" else max(value, price)

    def metric(self, id: str) -> Metric:
        """The metric `id`; FreeArtError lists the known ones."""
        for metric in self.metrics:
            if metric.id == id:
                return metric
        raise FreeArtError(f"unknown metric '{id}'; metrics of {self.name}: {', '.join(m.id for m in self.metrics)}")


def protocol_named(name: str) -> Protocol:
    """The protocol `name`; FreeArtError lists the known ones."""
    if name not in PROTOCOLS:
        raise FreeArtError(f"unknown protocol '{name}'; protocols: {', '.join(sorted(PROTOCOLS))}")
    return PROTOCOLS[name]


def _surface(id: str, what: str, column: str) -> Metric:
    return Metric(
        id,
        "%",
        "%",
        "down",
        100.0,
        (
            f"{what}: mean of the two directed mean distances, point to triangle, 100k seeded samples; truth to "
            "prediction samples the truth's visible surface, prediction to truth measures to the whole outer surface; "
            "averaged over the five frames whose true states lie nearest to five values spread evenly over the range, "
            "parts posed in the camera frame by each side's own reference pose and state"
        ),
        label=f"chamfer, {what}",
        column=column,
    )


_STATE = (
    "mean absolute difference over {frames}; one global sign, that of the dot product of the two axes; the "
    "offset that makes it smallest (the median) removed; revolute states wrapped"
)
_BOTH = (
    "frames in which the truth shows both parts with 1 % or more of the foreground each (over all frames when "
    "there is none)"
)

STRICT_1 = Protocol(
    "strict-1",
    "Parts are matched to the truth by the better mIoU of the two labelings; on a tie, by the reference poses. "
    "T_truth_pred is the robust mean (chordal L2 for the rotation, translation at the centre of the truth's reference "
    "part, 2 sigma trimmed) over all frames of T_camera_reference(truth)^-1 T_camera_reference(prediction); never "
    "chosen by the joint; scale 1; no registration of parts. A part's centre is that of its outer surface's area. "
    "Lengths are in % of the diagonal of the truth's bounding box at frame 0, cm beside. The joint is measured from "
    "the asset, reloaded and driven in SAPIEN, states beyond its limits driven to the limit; without an asset, read "
    "from the files and marked so. Means and sample standard deviations (ddof 1) are over all sequences of a joint "
    "type: a failure or a missing sequence is priced, never dropped.",
    (
        Metric(
            "joint_type",
            "fraction",
            "fraction",
            "up",
            0.0,
            "1 when the joint's type is right, else 0",
            label="joint type",
        ),
        Metric(
            "axis",
            "deg",
            "deg",
            "down",
            90.0,
            "arccos of the clipped absolute dot product of the axes",
            label="axis direction",
            column="axis",
        ),
        Metric(
            "position",
            "%",
            None,
            "down",
            100.0,
            "distance from the point of the true axis nearest the moving part's centre to the predicted line",
            label="place of the axis",
            column="place",
        ),
        Metric(
            "position_line",
            "%",
            None,
            "down",
            100.0,
            "distance between the two axes as lines; point to line when they are parallel within 1e-6",
            "position",
            label="place of the axis, line to line",
        ),
        Metric("state", "deg", "%", "down", None, _STATE.format(frames=_BOTH), label="joint state", column="state"),
        Metric(
            "state_all", "deg", "%", "down", None, _STATE.format(frames="all frames"), label="joint state, all frames"
        ),
        Metric(
            "miou",
            "fraction",
            "fraction",
            "up",
            0.0,
            "intersection over union, mean over frames and both parts; a part absent in both counts 1",
            label="part masks (mIoU)",
            column="mIoU",
        ),
        Metric(
            "pose_rotation",
            "deg",
            "deg",
            "down",
            180.0,
            "mean geodesic error of the reference part over all frames after alignment",
            label="rotation of the reference part",
            column="ref.\npart",
        ),
        Metric(
            "pose_translation",
            "%",
            "%",
            "down",
            100.0,
            "mean distance of the reference part's centre over all frames after alignment",
            label="place of the reference part",
        ),
        _surface("chamfer_w", "whole object", "cham.\nwhole"),
        _surface("chamfer_m", "moving part", "cham.\nmoving"),
        _surface("chamfer_s", "reference part", "cham.\nref."),
        Metric(
            "fscore",
            "fraction",
            "fraction",
            "up",
            0.0,
            "whole object: harmonic mean of precision and recall of the same samples within 1 % of the diagonal",
            label="F-score, whole object",
        ),
        Metric(
            "psnr",
            "dB",
            "dB",
            "up",
            0.0,
            "held-out queries, uint8, over the pixels of the truth's mask, white elsewhere, mean over queries; at "
            "most 100; no search at test time; a missing render counts 0",
            label="held-out views (PSNR)",
            column="views\nPSNR",
        ),
        Metric(
            "ssim",
            "fraction",
            "fraction",
            "up",
            0.0,
            "structural similarity (Gaussian window, sigma 1.5) of the same pictures, mean over the mask's pixels",
            "psnr",
            label="held-out views (SSIM)",
        ),
    ),
    strict1.measure,
)

_OWN_ALIGNMENT = (
    "over all frames after an alignment of its own, the robust mean of the moving part's poses: its canonical frame "
    "and state zero are the method's affair, so this is how well the part is followed, whatever the joint"
)


def _of_parts(metric: Metric) -> Metric:
    """The same number from the part files, beside the asset's."""
    return replace(
        metric,
        id=f"{metric.id}_parts",
        definition=f"{metric.id} measured from parts/*.ply instead of the asset's visual meshes",
        beside=metric.id,
        label=f"{metric.label}, from the part files",
        column="",
    )


def _strict_2_metrics() -> tuple[Metric, ...]:
    """Those of strict-1, the moving part's poses after the reference part's, and surfaces of the part files beside."""
    metrics: list[Metric] = []
    for metric in STRICT_1.metrics:
        metrics.append(metric)
        if metric.id == "pose_translation":
            metrics += [
                Metric(
                    "pose_moving_rotation",
                    "deg",
                    "deg",
                    "down",
                    180.0,
                    f"mean geodesic error of the moving part {_OWN_ALIGNMENT}",
                    label="rotation of the moving part",
                    column="moving\npart",
                ),
                Metric(
                    "pose_moving_translation",
                    "%",
                    "%",
                    "down",
                    100.0,
                    f"mean distance of the moving part's centre {_OWN_ALIGNMENT}",
                    label="place of the moving part",
                ),
            ]
        if metric.id == "fscore":
            metrics += [_of_parts(m) for m in STRICT_1.metrics if m.id.startswith("chamfer") or m.id == "fscore"]
    return tuple(metrics)


STRICT_2 = Protocol(
    "strict-2",
    STRICT_1.preamble.replace(
        "The joint is measured from the asset, reloaded and driven in SAPIEN, states beyond its limits driven to the "
        "limit; without an asset, read from the files and marked so.",
        "The joint is measured from the asset, reloaded and driven in SAPIEN, states beyond its limits driven to the "
        "limit. Surfaces are the asset's own visual meshes, placed by the simulator's link poses at the answer's "
        "states; those of the part files stand beside. Without an asset both are read from the files and marked so. An "
        "asset with a broken mesh or mass is a failure. Held-out views may be given for both choices of the reference "
        "part; those of the matched choice count. A price is a cap: no number costs more than a failure.",
    ),
    _strict_2_metrics(),
    strict2.measure,
    whole_asset=True,
    capped=True,
)

PROTOCOLS: dict[str, Protocol] = {STRICT_1.name: STRICT_1, STRICT_2.name: STRICT_2}
"""Every protocol by its name."""
DEFAULT = STRICT_2.name
"""The protocol by which is scored when none is named."""
