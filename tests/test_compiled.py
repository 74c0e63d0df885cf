"""Laws are compiled as they are written: divided as on paper, chosen by the type of a record, once for each type."""

from typing import Annotated, Any

import numpy as np
import pytest

from ltvpneu._arrays import FloatArray, layout
from ltvpneu._compiled import by_field, compiled


class Load:
    mass: float


class Plain:
    load: Load
    n: int
    ramped: bool
    areas: Annotated[FloatArray, 2, 3]


class General(Plain):
    pressure: float


def record_of(kind: type) -> Any:
    records = np.zeros(1, layout(kind))
    records["load"]["mass"], records["n"], records["areas"] = 4.0, 3, 0.5
    return records


def test_a_compiled_law_divides_as_on_paper():
    @compiled
    def inverse(x: float) -> float:
        return 1.0 / x

    assert inverse(0.0) == float("inf")


def test_a_records_layout_is_that_of_its_class():
    assert layout(Plain).names == ("load", "n", "ramped", "areas")
    assert layout(Plain)["areas"].shape == (2, 3)
    # One that only went on where the other ends would be taken for it.
    assert layout(General).names == ("pressure", "load", "n", "ramped", "areas")


def test_a_law_is_chosen_by_the_type_of_a_record_and_compiled_only_where_it_is():
    @compiled
    def of_mass(mass: float) -> float:
        return 2.0 * mass

    @compiled
    def of_pressure(pressure: float) -> float:
        return pressure + 1.0

    def in_general(machine: General) -> float:
        return of_pressure(machine.pressure)

    def on_paper(machine: Plain) -> float:
        return of_mass(machine.load.mass)

    force = by_field("pressure", "machine", in_general, on_paper)

    @compiled
    def kernel(records: Any) -> float:
        return force(records[0]) + records[0].areas[1, 2] * records[0].n

    assert kernel(record_of(Plain)) == 9.5
    assert not of_pressure.signatures
    assert kernel(record_of(General)) == 2.5
    assert len(of_pressure.signatures) == len(of_mass.signatures) == 1
    with pytest.raises(TypeError, match="only kernels choose"):
        force(record_of(Plain)[0])


def test_a_literal_argument_compiles_no_kernel_of_its_own():
    @compiled
    def scaled(factor: int, x: float) -> float:
        return factor * x

    @compiled
    def kernel(n: int, x: float) -> float:
        return scaled(3, x) + scaled(4, x) + scaled(n, x)

    assert kernel(5, 1.0) == 12.0
    assert len(scaled.signatures) == 1
