"""Benchmarks of the solver and of the window, run from the repository; they are not installed.

Each module is a program, ``python -m benchmarks.NAME``, which prints the tables of one page of the
documentation.
"""
