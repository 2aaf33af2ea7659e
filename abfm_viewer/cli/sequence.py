"""`abfm sequence`: the fields between the frames of a sequence."""

import argparse

from abfm.sequences.task import SequenceTask
from abfm_viewer.cli import solve

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
_OUT = (
    "sequence .npz; .html for a browser; .pvd with a folder of .vtu for ParaView; the speed at "
    "vertices as -lh.stc or -rh.stc for MNE, or as .func.gii"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    solve.add_arguments(parser, SequenceTask, _OUT)


def run(arguments: argparse.Namespace) -> int:
    return solve.run(arguments, SequenceTask)
