"""Constants of the continuation, each with its evidence.

Titles in quotation marks are sections of docs/convergence.md. "41 problems" are those of the
section "What each part contributes". With the values below, both checks confirm all of them.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class ContinuationSettings:
    """Constants of the continuation that are not parameters."""

    # residual at which the search has found the target: "A long-range norm"
    found_residual: float = 0.75
    # alpha of the second variant of measured functions, relative to the parameter. With an earlier
    # selection of sigma, source and target on a cortex correlate to 0.923 with this variant, and to
    # 0.905 without it
    second_alpha_share: float = 1 / 3
    # multiples of the given sigma that are minimised, without a search, if only landmarks are
    # matched
    landmark_sigma_factors: tuple[float, ...] = (100.0, 10.0, 1.0)
    # ratio of the first to the last landmark_sigma of a path
    landmark_factor_max: float = 100.0
    # landmark_sigma falls with this power of sigma, so that landmarks are matched first
    landmark_power: float = 2.0

    # a step ends when the energy falls by less than fall_min within fall_iterations. With 1%, 39 of
    # 41 problems are confirmed. With 12 iterations, 40 are confirmed in 1.4 times the time
    fall_min: float = 0.03
    fall_iterations: int = 6
    # below this sigma, alpha falls as the square of sigma. With a constant alpha, 39 of 41 problems
    # are confirmed, in 1.6 times the time
    stiff_sigma: float = 0.05
    # a step ends at this share of the goal, as flow lines usually have a larger residual. With 1,
    # and without the limit of effort on finer meshes, 41 problems take 1.4 times as long
    goal_share: float = 0.8
    # largest share of all iterations on meshes coarser than the mesh itself. None of 67 problems is
    # matched less well, and runs with few iterations reach the mesh itself
    coarse_iteration_share: float = 0.75
    # a defect correction needs a discrete residual of at most this multiple of the goal. Without
    # the limit, 40 of 41 problems are confirmed, and a human body takes 781 iterations instead of
    # 641
    correction_factor_max: float = 1.6

    # number of vertices of the coarsest mesh, and ratio of the numbers of consecutive meshes: "From
    # coarse to fine"
    coarsest_vertices: int = 2500
    level_ratio: float = 4.0
    # a mesh has coarser ones if its vertices exceed this multiple of coarsest_vertices (7,500)
    coarsening_factor_min: float = 3.0
    # least number of edges that features span on a coarser mesh, which would distort narrower ones
    feature_edges_min: float = 3.0
    # largest cost of iterations without clusters, relative to those with them
    cluster_cost_max: float = 2.0
    # least number of iterations without clusters
    exact_iterations_min: int = 2
    # a field of a coarser mesh is stable if its residual is at most stable_factor times that on the
    # coarser mesh plus stable_residual
    stable_factor: float = 2.0
    stable_residual: float = 0.4
    # numbers of edges over which fields of a coarser mesh are smoothed until they are stable, and
    # while that lowers the energy. Kinks over coarse edges multiply the norm of second order by
    # hundreds
    smoothing_edges: tuple[float, ...] = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)

    # limits of refinement unless the user requests it: "Finer meshes". They are the vertices of
    # the finest mesh, and the matrix row products on all finer meshes (about a minute)
    refined_vertices_max: int = 60_000
    refinement_effort_max: float = 5e9
    # number of iterations on a finer mesh that refinement_effort_max has to allow
    refinement_iterations_min: int = 20

    # a start with a larger residual misses the target, so that a search begins
    missed_residual: float = 0.3
    # a start whose residual is larger than this multiple of that without motion is not used
    diverged_factor: float = 3.0
    # a start is unstable if it makes values larger than this multiple of the source, since the
    # target then vanishes in rounding errors
    unstable_factor: float = 1e8

    # truncation of the advection in a descent, which is not sensitive to smaller errors; the
    # gradient is exact for any value
    advection_tolerance: float = 1e-7
    # number of iterations between two computations of the curvature of landmarks
    curvature_iterations: int = 10
    # largest number of stored values of the curvature of landmarks, because of memory
    curvature_size_max: float = 5e7

    # number of patches and of cross-validation folds of the surface. With 40 patches, the errors of
    # the maps of 32 known flows are 1.10 times as large
    patches: int = 150
    folds: int = 3
    # weight of the mean ``|log2 J|`` in the score of a step, relative to the held-out residual. For
    # 32 known flows, the error of the map of the selected step is on average 1.10 times that of the
    # best step. With ``abfm.registration.MEASURED_PARAMETERS`` it is 1.07 times. If the discrete
    # flow selects the step, the ratio is 1.19 with weight 0.3, and 1.23 with weight 0.2
    area_weight: float = 0.25
    # a fold continues while its energy falls by fold_fall_min within fold_iterations. All folds
    # take 1.5 times the evaluations of the steps, and with the limits of a step 3.2 times. Sigma
    # differs by 1% to 2% on a cortex
    fold_fall_min: float = 0.2
    fold_iterations: int = 4

    # number of vertices from which flow lines start, on evenly spaced faces: "Verification"
    flow_line_vertices_max: int = 20_000
    # largest number of faces that are cut into parts to find folded ones; more would find no others
    cut_faces_max: int = 64
    # number of iterations before the first warning; a source that moves has moved by then
    warning_iterations_min: int = 10


SETTINGS = ContinuationSettings()
