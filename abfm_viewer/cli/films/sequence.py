"""`abfm sequence`: a film of a function, and the fields that carry each frame to the next."""

import argparse
import json
import os
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np

import abfm
from abfm import Control, Sequence, pages
from abfm.errors import printable
from abfm.sequences import ENDINGS, GAMMA, TAKEN, Unfinished, defaults, read_frames
from abfm.sequences.reading.vtk_frames import files_of_frames
from abfm.types import FloatArray
from abfm_viewer.cli import options
from abfm_viewer.cli.exit_status import UsageError
from abfm_viewer.cli.films import results as sequence_results
from abfm_viewer.cli.match import cancelled_by_signals, status_of
from abfm_viewer.cli.progress import long_steps, steps_progress
from abfm_viewer.cli.results import print_notes
from abfm_viewer.files import outputs

SUMMARY = "find the fields that carry each frame of a film on a surface to the next"
DESCRIPTION = """\
Find, for each two frames of a function that changes in time, the vector field whose flow carries
the one to the other: optical flow on a surface. Fields of neighbouring intervals are held together,
and each is checked by flow lines.

Examples:
  abfm sequence lh.pial wave.npy --dt 0.001 --out wave.npz --out wave.html
  abfm sequence fsaverage5_left.gii bold.func.gii --mask cortex.csv --out bold.npz --out bold.pvd
  abfm sequence lh.white sources-lh.stc --out flow.npz --out speed-lh.stc --tracks tracks.csv
  abfm sequence mesh.ply simulation.pvd --array u --gamma 0 --out s.npz

Frames are an array (T, V) or (T, V, C) in .npy, .npz ("frames", and perhaps "times") or .mat, a
table, GIFTI, CIFTI or .mgh file with a column for each, one hemisphere of MNE's .stc, or ParaView's
.pvd, .series, or one of numbered .vtu, .vtp or .vtk files. Rows that name their vertex are placed.

The exit status is 0 when flow lines confirm at least half of the intervals, 3 when they confirm
fewer, 2 for bad input, and 130 or 143 when Ctrl-C or SIGTERM ended the run: what was found is
written, and the fields of other intervals are 0. Beside the first output, a file FILE-*.unfinished
keeps what is found until all is written: the same command goes on from it, whatever ended the run.
"""
_PARAMETERS = {
    "alpha": "smoothness of the fields: weight of their Hodge Laplacian; not given, chosen by "
    "held-out patches of a few intervals",
    "order": "order of the norm of the fields: 1, the paper's, or 2, which is smoother; not given, "
    "chosen by held-out patches",
    "sigma": "weight of the match against the smoothness, in deviations of the frames: smaller "
    "matches closer; not given, the largest that predicts held-out patches nearly as well as any",
    "sigma_unit": "sigma in deviations of the frames from their mean in L2, or as the paper has it",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_mesh(parser)
    add = options.adder(parser)
    add("frames", f"the film: {', '.join(ENDINGS)}", "FRAMES")
    add = options.adder(parser.add_argument_group("frames"))
    add(
        "--dt",
        "seconds from a frame to the next, whatever the file says (default: as it says, or 1)",
        "SECONDS",
        type=options.positive,
    )
    options.add_circular(add)
    add("--array", "which array of a .npz, .mat or .ply, or of VTK's point data", "NAME")
    add(
        "--mask",
        "weight of the mismatch at each vertex, not negative, 0 where values are not known: a "
        "function or its file",
        "SPEC",
    )
    add(
        "--weights",
        "weight of each channel, not negative (default: 1 each)",
        "W,W,...",
        type=options.weights,
    )
    add = options.adder(parser.add_argument_group("smoothness in time"))
    add(
        "--gamma",
        f"how much fields of neighbouring intervals are held together; 0 is frame by frame "
        f"(default: {GAMMA:g})",
        "X",
        type=options.gamma,
        default=GAMMA,
    )
    options.add_parameters(parser, defaults(), TAKEN, _PARAMETERS)
    add = options.adder(parser.add_argument_group("output"))
    add(
        "--out",
        "sequence .npz; .html for a browser; .pvd with a folder of .vtu for ParaView; the speed at "
        "vertices as -lh.stc or -rh.stc for MNE, or as .func.gii; repeatable",
        "FILE",
        type=Path,
        action="append",
        required=True,
    )
    options.add_up(add)
    add("--tracks", "table of critical points through time", "FILE.csv", type=Path)
    add(
        "--intervals",
        "table of the intervals: speed, its uncertainty, residuals and verdict",
        "FILE.csv",
        type=Path,
    )
    add("--json", "print one JSON object about the result")
    add("--quiet", "no progress")


def run(arguments: argparse.Namespace) -> int:
    """Solve and write; 3 when most are not confirmed, 128 and its number after a signal."""
    tables = [path for path in (arguments.tracks, arguments.intervals) if path is not None]
    for path in arguments.out:
        outputs.check_sequence(path)
    for path in tables:
        outputs.check(path, (".csv",))
    frames = arguments.frames
    read = [arguments.mesh, frames, arguments.mask, *files_of_frames(frames)]
    for path in (*arguments.out, *tables):
        outputs.check_not_read(path, read)
    if len({*arguments.out, *tables}) < len(arguments.out) + len(tables):
        raise UsageError("two outputs have the same name; give each its own")
    parameters = defaults(**options.given_parameters(arguments))
    control, start = Control(), time.perf_counter()
    with long_steps(arguments.quiet):
        mesh = options.mesh(arguments)
        film = read_frames(arguments.frames, mesh, arguments.array)
        mask = options.weight(mesh, arguments.mask)
    print_notes(film.notes)
    times, unit = _times(arguments, film.times, len(film.values))
    for path in arguments.out:
        if path.suffix == ".stc" and times is not None:
            abfm.io.even_step(path, (times[1:] + times[:-1]) / 2)
    unfinished = Unfinished(arguments.out[0], partial(_tell_of_earlier, len(film.values) - 1))
    with cancelled_by_signals(control, "with what was found") as kept:
        with steps_progress(arguments.quiet):
            found = abfm.sequence(
                mesh,
                film.values,
                times,
                parameters,
                arguments.gamma,
                mask=mask,
                weights=arguments.weights,
                circular=arguments.circular or False,
                unfinished=unfinished,
                control=control,
            )
        _write(arguments, found, unit, unfinished if kept.number is None else None)
    seconds, written = time.perf_counter() - start, [*arguments.out, *tables]
    if arguments.json:
        own = {"mesh": arguments.mesh, "film": arguments.frames}
        told = {"seconds": seconds, "outputs": list(map(str, written))}
        print(json.dumps({**own, **sequence_results.facts(found), **told}))
    else:
        names = ", ".join(map(printable, written))
        begin = [] if kept.number is None else [_cancelled(unfinished)]
        lines = [*begin, *sequence_results.lines(found, unit), f"in {seconds:.1f} s; wrote {names}"]
        print("\n".join(lines))
    return status_of(found.facts, kept.number)


def _write(
    arguments: argparse.Namespace, found: Sequence, unit: str, finished: Unfinished | None
) -> None:
    """Write all outputs; remove what was kept of a finished sequence once the result is safe."""
    is_safe = True
    try:
        with long_steps(arguments.quiet):
            notes = outputs.write_sequences(
                arguments.out,
                found,
                arguments.tracks,
                arguments.intervals,
                pages.Labels(unit_of_time="s" if unit == "second" else "", up=arguments.up),
            )
        print_notes(notes)
    except outputs.LostResultError:
        is_safe = False
        raise
    finally:
        if finished is not None and is_safe:
            finished.remove()


def _times(
    arguments: argparse.Namespace, of_file: FloatArray | None, count: int
) -> tuple[FloatArray | None, str]:
    """Return the times of the frames, and the unit that speeds are told in."""
    if arguments.dt is not None:
        return arguments.dt * np.arange(count, dtype=np.float64), "second"
    if of_file is None:
        told = "note: the file says no times: frames count as 1 apart; --dt gives seconds"
        print(told, file=sys.stderr)
    return of_file, "frame" if of_file is None else "second"


def _tell_of_earlier(intervals: int, found: int) -> None:
    told = f"note: going on after {found} of {intervals} intervals, which an earlier run found"
    print(told, file=sys.stderr, flush=True)


def _cancelled(unfinished: Unfinished) -> str:
    told = "cancelled: what was not solved has no motion"
    if unfinished.path is None or not os.path.isfile(unfinished.path):
        return told
    return f"{told}; the same command goes on, by {printable(unfinished.path)}"
