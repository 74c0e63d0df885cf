"""A machine reaches the kernels as it is: its record, the pieces of its openings, and what has no room there."""

from dataclasses import replace

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.openings import pieces_of, write_areas
from ltvpneu.models.machine.records import EXHAUST, GENERAL, MAX_PATHS, PLAIN, SUPPLY
from tests.conftest import EXTENSIONS, MACHINES


def fields(record: object) -> dict:
    """Return what a numpy record holds, by name."""
    return {name: record[name] for name in record.dtype.names}  # type: ignore[attr-defined,index]


def test_a_record_holds_what_the_machine_does(table_1):
    record = fields(table_1.record)
    assert record["load"]["mass"] == table_1.load.mass
    assert record["supply"]["pressure"] == table_1.supply_pressure
    assert record["n_volumes"] == 1
    assert record["volumes"][0]["push_area"] == table_1.cylinder.push_area_1
    assert [record["paths"][p]["source"] for p in range(record["n_paths"])] == [SUPPLY, EXHAUST]


@pytest.mark.parametrize("name", MACHINES)
def test_the_papers_machines_and_no_others_have_the_short_record(name):
    assert MACHINES[name].record.dtype == (PLAIN if MACHINES[name].is_plain else GENERAL)


@pytest.mark.parametrize("name", EXTENSIONS)
def test_a_medium_or_a_temperature_of_its_own_takes_the_general_record(name):
    machine: Machine = EXTENSIONS[name]
    assert machine.record.dtype == (PLAIN if machine.is_plain else GENERAL)
    places = [volume.temperature_place for volume in machine.volume_fields if volume.temperature_place >= 0]
    assert places == list(range(2 + machine.n_volumes, len(machine.states)))


def test_a_machine_that_has_no_room_in_a_record_is_told_so(table_1):
    bleed = table_1.flow_paths[0] if table_1.flow_paths else lp.FlowPath(source="exhaust", area=1e-7)
    with pytest.raises(ValueError, match=rf"found \d+ flow paths, expected at most {MAX_PATHS}"):
        replace(table_1, flow_paths=(bleed,) * (MAX_PATHS + 1))


@pytest.mark.parametrize("name", MACHINES)
def test_areas_at_an_instant_are_the_same_in_a_kernel_and_in_arrays(name):
    table = MACHINES[name].openings
    pieces = pieces_of(table, 0.25)
    fractions = np.linspace(0.0, 1.0, 97)[:-1] + 1e-3
    number = table.pieces_at(fractions)
    expected = table.areas_at(fractions, number)
    for fraction, piece, areas in zip(fractions, number, expected, strict=True):
        found = np.empty(areas.shape)
        write_areas(0.25 * fraction, pieces[piece], found)
        np.testing.assert_allclose(found, areas, rtol=1e-12, atol=1e-20)
