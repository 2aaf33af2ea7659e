"""Table 1."""

import pytest

from abfm import Parameters
from abfm.parameters import TABLE_1, row_of

PRINTED = """
Fig. 1  | 1  | 1    | 0    | 1e-2* | -  | 10
Fig. 3  | 2  | 1e+3 | 1e-5 | 1e-4  | -  | 40
Fig. 7  | 1  | 1e+3 | 0    | 1e-1* | 20 | -
Fig. 8  | 10 | 1e+3 | 0    | 1e-2* | -  | 200
Fig. 9  | 1  | 1    | 1e-4 | 5e-3  | -  | 20
Fig. 10 | 1  | 1e+3 | 0    | 1e-2* | -  | 20
Fig. 11 | 1  | 1    | 0    | 1e-2* | 10 | -
Fig. 12 | 1  | 1    | 0    | 1e-2* | 10 | -
"""


ROWS = list(zip(TABLE_1.values(), PRINTED.strip().splitlines(), strict=True))


@pytest.mark.parametrize(("row", "printed"), ROWS)
def test_a_row_is_as_printed(row, printed):
    name, tau, alpha, beta, sigma, N, n = (cell.strip() for cell in printed.split("|"))
    parameters = row.parameters(iterations=7)
    assert row.name == name
    assert parameters.iterations == 7
    found = (parameters.tau, parameters.alpha, parameters.beta)
    assert found == (float(tau), float(alpha), float(beta))
    assert parameters.stage_sigmas()[0] == pytest.approx(float(sigma.strip("*")))
    assert parameters.cooling_stages == (3 if sigma.endswith("*") else 1)
    if n == "-":
        assert (parameters.method, parameters.segments) == ("linearised", int(N))
    else:
        found = (parameters.method, parameters.segments, parameters.substeps)
        assert found == ("nonlinear", 1, int(n))


@pytest.mark.parametrize("row", list(TABLE_1.values()))
def test_a_row_has_the_energy_of_the_paper(row):
    found = row.parameters(iterations=7)
    assert (found.order, found.sigma_unit) == (1, "absolute")
    assert (found.reach, found.levels, found.balance) == (0, 1, 0)
    assert row_of(row.parameters(order=2)) is None


def test_a_row_is_recognised_until_one_of_its_values_changes():
    assert row_of(Parameters()) is None
    for row in TABLE_1.values():
        found = row_of(row.parameters(iterations=3))
        assert found is not None
        assert found.values == row.values
        assert row_of(row.parameters(alpha=2.0)) is None
