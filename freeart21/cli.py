"""The command line: the one file that imports all packages.

A command is a function of its package's `commands.py`; here are those that span several packages. tyro reads a
function's signature and docstring, or the fields of its options and theirs.
"""

from __future__ import annotations

import inspect
import math
import sys
from collections.abc import Callable
from dataclasses import fields, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

import freeart21
from export.settings import Masses, Materials
from freeart21 import processes
from freeart21.errors import FreeArtError
from freeart21.formats.series_settings import SeriesSettings
from freeart21.processes import DOUBTFUL, report_errors
from simgap.commands import TruthOptions

if TYPE_CHECKING:
    from freeart21.files.masks import Click

Positional: Any = tyro.conf.Positional
Flat: Any = tyro.conf.arg(name="")
DESCRIPTION = "FreeArt-21: from RGB-D videos of articulated objects to simulation-ready assets, and their score."
COMMANDS = {
    "doctor": "freeart21.commands",
    "demo": "freeart21.cli",
    "objects": "freeart21.commands",
    "record": "generator.commands",
    "teleop": "generator.commands",
    "verify": "generator.commands",
    "convert": "generator.commands",
    "look": "freeart21.cli",
    "masks": "freeart21.cli",
    "film": "freeart21.cli",
    "reconstruct": "reconstruct.commands",
    "export": "export.commands",
    "joint-asset": "export.commands",
    "check-asset": "export.commands",
    "view": "freeart21.commands",
    "init-submission": "leaderboard.commands",
    "import": "leaderboard.commands",
    "run": "leaderboard.commands",
    "validate": "leaderboard.commands",
    "score": "leaderboard.commands",
    "compare": "leaderboard.commands",
    "site": "leaderboard.commands",
    "pack": "leaderboard.commands",
    "release": "leaderboard.commands",
    "measure": "freeart21.cli",
    "gap": "simgap.commands",
    "replay": "simgap.commands",
}
"""Command to the module of its function, in the order of the help text."""


def demo(
    name: Annotated[str, Positional] = "stapler",
    out: Path = Path("out/demo"),
    frames: int = 90,
    seed: int = 1,
    partnet_root: Path | None = None,
    joint: str | None = None,
) -> None:
    """Run the whole pipeline on one object: simulate, record, reconstruct, export, simulate, score, and make a page.

    Args:
        name: Object of the catalog, or a PartNet-Mobility id.
        out: Folder for all results. An older demo there is replaced.
        frames: Frames of the video.
        seed: Seed of shape, motion and views; 1 shows the stapler from above and below.
        partnet_root: Folder of PartNet-Mobility objects, as ROOT/41083/mobility.urdf.
        joint: Moving joint of a PartNet-Mobility object.
    """
    from export.exporter import export_result
    from freeart21.files.atomic import new_folder, write_json
    from freeart21.files.lock import only_writer
    from freeart21.files.places import DEMO, check_place
    from freeart21.reconstruction import Failure
    from freeart21.view import write_page
    from generator.dataset import plan_jobs
    from generator.recorder import record
    from generator.settings import RecordSettings
    from leaderboard.score import score_results
    from leaderboard.scores_file import write_scores
    from leaderboard.tables import page_entries, print_scores, score_note
    from reconstruct.pipeline import reconstruct_folder
    from reconstruct.settings import GaussianSettings, ReconstructSettings

    check_place(out, DEMO)
    settings = RecordSettings(  # small pictures and few views: 3 minutes 20 s on two cores
        frames=frames, seed=seed, width=480, height=270, queries=8, partnet_root=partnet_root, joint=joint
    )
    plan_jobs((name,), settings)  # raises for an unknown object before anything is written
    with only_writer(out), new_folder(out, DEMO) as aside:
        data, results = aside / "data", aside / "results" / "ours"
        print(f"Recording {frames} frames of {name} in the simulator", flush=True)
        sequence = record(name, data, settings)
        print("Reconstructing it from the video alone", flush=True)
        light = GaussianSettings(rounds=6, most_pixels=20_000, begin=8_000, most=12_000)  # less than half of the time
        answer = reconstruct_folder(
            data / "sequences" / sequence, results / sequence, ReconstructSettings(gaussians=light)
        )
        if not isinstance(answer, Failure):
            print("Exporting it as a textured asset for simulators, and reloading that", flush=True)
            try:
                video = data / "sequences" / sequence
                export_result(results / sequence, results / sequence / "asset", video=video)
            except FreeArtError as error:  # the score and the page show the missing asset
                print(f"No asset: {error}", file=sys.stderr)
        print("Scoring the reloaded asset and the result's masks, poses and views against the truth", flush=True)
        scores = score_results(results, data)
        write_scores(aside / "scores.json", scores)
        write_page(
            results / sequence,
            aside / "index.html",
            truth=data / "truth" / sequence,
            sequence=data / "sequences" / sequence,
            scores=page_entries(scores.rows[0], scores.protocol),
            score_note=score_note(scores.rows[0], scores.protocol),
        )
        write_json(aside / DEMO.marker, {"schema": "freeart21/demo/1", "object": name})
    print_scores(scores)
    print(f"All results are in {out}; open {out / 'index.html'} in a browser.")


def measure(
    sources: Annotated[tuple[Path, ...], Positional],
    out: Path,
    series: Annotated[SeriesSettings, Flat] = SeriesSettings(),  # noqa: B008 (frozen)
    truths: Annotated[TruthOptions, Flat] = TruthOptions(),  # noqa: B008 (frozen)
) -> None:
    """Make a measured set for `gap`: from CSV, JSON or MAT files, a filmed result, or recorded truths.

    Args:
        sources: Files of a joint's position over time (a run each), with --asset; or one result folder (RESULTS/SEQ)
            whose reference part stood still, with --gravity; or truth folders of one object (DATA/truth/SEQ, each
            recorded with --motion release).
        out: Folder for the measured set (OUT/measured) and, for truths, the object without effects (OUT/asset).
    """
    files = [source for source in sources if source.is_file()]
    results = [source for source in sources if (source / "prediction.json").is_file()]
    for source in sources:
        if not source.exists():
            raise FreeArtError(f"measure: {source} does not exist")
    if not sources or (files and len(files) < len(sources)):
        got = ", ".join(str(source) for source in sources if source not in files)
        raise FreeArtError(
            f"measure: expected files, one result, or truth folders; got {f'{got} among files' if got else 'nothing'}"
        )
    kind = "files" if files else "a result" if results else "truths"
    for whose, options in (("files", series), ("truths", truths)):
        given = [f.name.replace("_", "-") for f in fields(options) if getattr(options, f.name) != f.default]
        given = [name for name in given if kind != "a result" or name not in ("gravity", "rate-hz")]
        if given and whose != kind:
            named = ", ".join(str(source) for source in sources)
            raise FreeArtError(f"measure: --{given[0]} applies to {whose}, but this was taken for {kind}: {named}")
    asset = out / "asset"
    if files:
        from freeart21.formats.measured_series import measure_series

        print("".join(f"- {note}\n" for note in measure_series(files, out, series)), end="")
        asset = series.asset or asset
    elif results:
        if len(sources) > 1 or series.gravity is None:
            raise FreeArtError(
                "measure: expected one result and --gravity X Y Z in the camera's axes of its first frame "
                f"(0 9.81 0 for a level camera); got {len(sources)} folders, gravity {series.gravity}"
            )
        from simgap.measure.reconstruction import measure_result

        measure_result(results[0], out, series.gravity, 30.0 if series.rate_hz is None else series.rate_hz)
        asset = results[0] / "asset"
    else:
        from generator.measure import TrackerNoise, measure_truths

        noise = TrackerNoise(1e-3 * truths.noise_mm, math.radians(truths.noise_deg), seed=truths.seed)
        measure_truths(sources, out, noise, truths.partnet_root, truths.urdf, truths.root)
    print(f"{out / 'measured'}: now `freeart21 gap {asset} {out / 'measured'} --out GAP`")


def look(sequence: Annotated[Path, Positional], out: Path | None = None) -> int:
    """Look at a video before it is solved: mask, depth, noise, motion, each with a grade and what to do.

    Nothing is solved. The exit code is 3 when something is bad: the video will hardly be solved.

    Args:
        sequence: A sequence folder (with sequence.json), such as `convert` makes.
        out: The page with a contact sheet; NAME-look.html in the working folder when not given.
    """
    from freeart21.files.places import PAGE, check_place
    from freeart21.view.masks_page import write_look_page
    from reconstruct.look import look_at, read_for_look

    page = out or Path(f"{sequence.resolve().name}-look.html")
    check_place(page, PAGE, [sequence])
    found = look_at(read_for_look(sequence))
    for finding in found.findings:
        print(f"{finding.grade:5} {finding.what}: {finding.value}{f'; {finding.advice}' if finding.advice else ''}")
    rows = [(f.what, f.value, f.grade, f.advice) for f in found.findings]
    write_look_page(rows, found.sheet, page, sequence.resolve().name)
    print(page)
    return DOUBTFUL if found.grade == "bad" else 0


def masks(
    source: Annotated[Path, Positional],
    out: Path,
    click: bool = False,
    port: int = 0,
    hands: Path | None = None,
    segmenter: str | None = None,
    depth_unit: float = 1e-3,
) -> int:
    """Make masks of a film without hand work: the object that is held in front, without hand and arm.

    It needs depth and an object that moves; camera and background may move, too. Every frame gets a doubt; the page
    shows the most doubtful frames first. Exit code: 0, or 3 when half of the frames are doubtful.

    Args:
        source: A recording of a camera, pictures, or a sequence folder; masks in it are not looked at.
        out: Folder for a mask a frame, masks.json and index.html; `convert` and `film` take it by --masks.
        click: Correct them by a few clicks on a page of this machine; the command goes on when the page saves.
        port: Of that page; a free one when 0.
        hands: Folder of MediaPipe's palm_detection_full.tflite and hand_landmark_full.tflite, which tell a hand from an
            object of its colour; those of the package mediapipe when it is installed (pip install --no-deps).
        segmenter: A network that carries the least doubtful masks, and the clicks, along the video: sam2, by weights
            that you bring (docs/priors.md).
        depth_unit: Metres per depth unit of a picture folder.
    """
    from freeart21.files.masks import write_masks
    from freeart21.files.places import MASKS, check_place
    from freeart21.formats.convert import find_sources
    from freeart21.formats.third_party import ReadOptions
    from freeart21.progress import progress_bar
    from freeart21.view.click_page import ClickServer
    from freeart21.view.masks_page import write_masks_page
    from reconstruct.hands import find_networks
    from reconstruct.masks import Foreground, carry_masks
    from reconstruct.segmenters import make_segmenter

    check_place(out, MASKS, [source])
    network = None if segmenter is None else make_segmenter(segmenter)
    found = find_sources(source)
    if len(found) != 1:
        raise FreeArtError(f"{source} has {len(found)} recordings, expected one")
    layout, folder = found[0]
    recording = layout.read(folder, ReadOptions(depth_unit=depth_unit)).recording
    with progress_bar("Finding the object") as show:
        foreground = Foreground(recording, hands or find_networks(), show)
    clicks: list[Click] = []
    if click:
        server = ClickServer(lambda i: recording.frame(i).rgb, foreground.masks, recording.name, len(recording), port)
        print(f"open {server.address}", flush=True)
        server.serve()
        clicks = server.clicks
    made = foreground.masks(clicks)
    if network is not None:
        made = carry_masks(recording, made, network, clicks)
    write_masks(out, made, clicks)
    doubtful = int((made.doubt > 0.5).sum())
    text = f"{doubtful} of {len(made.doubt)} masks are doubtful"
    lead = "Lit up: what is taken for the object. Where that is wrong, edit the masks of those frames."
    write_masks_page(recording, made, out / "index.html", [*made.notes, *([text] if doubtful else [])], lead)
    print("\n".join([*made.notes, f"masks: {text}; look at {out / 'index.html'}"]), flush=True)
    return DOUBTFUL if 2 * doubtful >= len(made.doubt) else 0


def film(
    source: Annotated[Path, Positional],
    out: Path,
    masks: Path | None = None,
    segmenter: str | None = None,
    mass: Masses = None,
    material: Materials = None,
    gaussians: bool = True,
    anyway: bool = False,
) -> int:
    """From a film of an object to a checked asset: convert, look, reconstruct, export, check-asset, a page.

    The same command goes on where it was stopped; what is finished is kept (remove it to make it anew). A camera's film
    needs masks: `--masks auto` makes them (look at masks/index.html); without --masks the first call writes the
    pictures to segment. Exit code: 0 sound, 3 doubtful or an asset that fails a rule, 1 no asset.

    Args:
        source: A recording of a camera (Record3D, Stray Scanner, .mkv, .bag, .mcap, pictures), or a sequence folder.
        out: Folder for all results: data, look.html, result with its asset, index.html.
        masks: Folder with a mask for each picture of the camera, object without hands; `auto` makes them, `click`
            with corrections on a page.
        segmenter: For masks that are made: as for `masks`.
        mass: Of the whole object, kg, or of parts, as for `export`; from a guessed density when not given.
        material: Of the whole object or of parts, as for `export`.
        gaussians: Refine by Gaussians and render with them; without, it takes a third of the time.
        anyway: Solve it though a property of the video is bad.
    """
    from export.commands import BY_ROLE, check_asset, export
    from freeart21.commands import view
    from freeart21.files.result import read_result
    from freeart21.reconstruction import Reconstruction
    from reconstruct.commands import reconstruct
    from reconstruct.settings import ReconstructSettings

    sequence, result = _film_sequence(source, out, masks, segmenter, anyway), out / "result"
    print(f"look: {out / 'look.html'}", flush=True)
    if look(sequence, out / "look.html") == DOUBTFUL and not anyway:
        raise FreeArtError(f"{source}: the video has a bad property (above); film it again, or solve it by --anyway")
    if (result / "prediction.json").is_file():
        print(f"reconstruct: {result} is finished; remove it to solve anew", flush=True)
    else:
        print(f"reconstruct: {result}", flush=True)
        settings = ReconstructSettings()
        settings = settings if gaussians else replace(settings, gaussians=replace(settings.gaussians, refine=False))
        if reconstruct(sequence, result, settings=settings) == 1:
            return 1
    if (result / "asset" / "asset.json").is_file():
        print(f"export: {result / 'asset'} is finished; remove it to export anew, as with another --mass", flush=True)
    else:
        print(f"export: {result / 'asset'}", flush=True)
        if export(result, result / "asset", sequence, replace(BY_ROLE, mass=mass, material=material)) == 1:
            return 1
    print("check-asset:", flush=True)
    verdict = check_asset(result / "asset", as_json=out / "check.json", certify=True)
    view(result, out / "index.html", sequence=sequence)
    answer = read_result(result)
    sound = isinstance(answer, Reconstruction) and answer.trust is not None and answer.trust.verdict == "sound"
    return max(verdict, 0 if sound else DOUBTFUL)


def _film_sequence(source: Path, out: Path, masks: Path | None, segmenter: str | None, anyway: bool) -> Path:
    """The sequence folder of a film: itself, the one made before, or converted now."""
    from generator.commands import convert

    if (source / "sequence.json").is_file():
        return source
    made = sorted((out / "data" / "sequences").glob("*/sequence.json"))
    pictures = source if (source / "cam_K.txt").is_file() else out / "data" / "pictures"
    if masks is not None and str(masks) in ("auto", "click"):
        by_click, masks = str(masks) == "click", out / "masks"
        if not made and not (masks / "masks.json").is_file():
            print(f"masks: {masks}", flush=True)
            if _make_masks(source, masks, click=by_click, segmenter=segmenter) == DOUBTFUL and not (anyway or by_click):
                raise FreeArtError(
                    f"{source}: most masks are doubtful, see {masks / 'index.html'}; correct them by "
                    f"`freeart21 masks {source} --out {masks} --click`, film it again, or go on by --anyway"
                )
    if not made:
        try:
            convert(source, out / "data", "native", masks=masks)
        except FreeArtError as error:
            if "has no masks" not in str(error):
                raise
            if not pictures.is_dir():
                convert(source, out / "data", "rgbd")
            raise FreeArtError(
                f"{source} has no masks: segment the object without the hands in the pictures of {pictures}, one mask "
                "a picture, and name their folder by --masks (or try --masks auto)"
            ) from error
        made = sorted((out / "data" / "sequences").glob("*/sequence.json"))
    if len(made) != 1:
        names = ", ".join(path.parent.name for path in made)
        raise FreeArtError(f"{source} has {len(made)} recordings, expected one; film one of them: {names}")
    return made[0].parent


_make_masks = masks  # `film` has an argument of that name


def load(name: str) -> Callable[..., Any]:
    """The function of a command."""
    function = "import_" if name == "import" else name.replace("-", "_")
    return getattr(import_module(COMMANDS[name]), function)


def main() -> None:
    """Run the command of `sys.argv`; errors are one line on standard error (`report_errors`)."""
    words = sys.argv[1:]
    if words[:1] == ["--version"]:
        print(f"freeart21 {freeart21.__version__}")
    elif words[:1] in ([], ["--help"], ["-h"]):
        print(describe_commands())
        sys.exit(0 if words else 2)
    elif words[0] not in COMMANDS:
        print(f"freeart21: there is no command '{words[0]}'; commands: {', '.join(COMMANDS)}", file=sys.stderr)
        sys.exit(2)
    else:
        processes.listen()
        with report_errors():
            code = _run_command(words[0], words[1:])
        sys.exit(code or 0)


def _run_command(name: str, words: list[str]) -> int | None:
    """Run a command with these words; gives its exit code. tyro prints help, and ends with code 2 on a bad option."""
    command = load(name)
    if name == "reconstruct":
        from reconstruct.commands import with_settings

        command = with_settings(words)
        words = ["--help" if word == "--settings.help" else word for word in words]
    return tyro.cli(command, prog=f"freeart21 {name}", args=words)


def describe_commands() -> str:
    """The help of the program: every command with the beginning of its docstring."""
    lines = ["usage: freeart21 COMMAND [OPTIONS]", "", DESCRIPTION, "", "commands:"]
    for name in COMMANDS:
        text = (inspect.getdoc(load(name)) or "").splitlines()[0]
        lines.append(f"  {name:16}  {text.partition(':')[0].rstrip('.')}")
    return "\n".join([*lines, "", "`freeart21 COMMAND --help` lists the options of a command."])
