"""`abfm match`: match two functions on one surface."""

import argparse

from abfm.functions import families
from abfm.matching.task import MatchTask
from abfm_viewer.cli import solve

SUMMARY = "find the field whose flow carries a source function to a target"
DESCRIPTION = f"""\
Find the vector field whose flow carries a source function to a target function, and write the
result.

Examples:
  abfm match spot.obj --source gaussian:vertex=12 --target gaussian:vertex=900 --out match.npz
  abfm match spot.obj --source eigenfunction:7 --target eigenfunction:8 --tau 2 --out m.vtu
  abfm match spot.obj --channel hks:time=0.01 file:h.npy 2 --out m.npz --out m.html

The exit status is 0 when source and target are matched or nearly so, or measured functions are
registered, as close as they bear; 3 when the target was not reached or no flow can reach it, with
what to try; 2 for bad input; and 130 or 143 when Ctrl-C or SIGTERM ended the run. The best result
is written in any case but that of bad input.

A function (SPEC) is family:key=value,... and several may be added with +. Families:
  {", ".join(family.family for family in families())}
For example gaussian:vertex=12,width=0.1 or expression:sin(10*x)*z; the README has them all.
"""
_OUT = (
    "result .npz, or .ply or .vtu for other programs, .csv with the energy, or .html for a "
    "browser: the surfaces, turning, with a time bar"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    solve.add_arguments(parser, MatchTask, _OUT)


def run(arguments: argparse.Namespace) -> int:
    return solve.run(arguments, MatchTask)
