"""Discrete calculus on a triangle mesh: operators, vector fields, decompositions, eigenfunctions, distances."""
