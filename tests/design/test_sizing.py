"""Parts for a task: the same as by trying every pair, and what is said where there are none."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu import design
from ltvpneu.face.machine_file import parse_machine
from ltvpneu.models.machine.catalogue import cheapest_first

SUPPLY = 7.01325e5


def drive(cylinder, valve, stroke, load):
    """A drive put together by hand."""
    return lp.Machine(
        name="by hand",
        supply_pressure=SUPPLY,
        exhaust_pressure=101325.0,
        cylinder=lp.catalog_cylinder(bore=cylinder.bore, rod=cylinder.rod, stroke=stroke, clearance=0.1),
        load=load,
        valve=lp.OnOffValve(),
        more_valves=(lp.OnOffValve(),) if "5/3" in valve.kind or " x " in valve.kind else (),
        flow_paths=lp.directional_paths(valve.kind, valve.law, exhaust=valve.exhaust),
    )


def enumerated(parts, stroke, load, most):
    """Every pair, cheapest first, none left out: the first that is in time both ways."""
    pairs = itertools.product(parts.cylinders, parts.valves)
    for cylinder, valve in sorted(pairs, key=lambda pair: (pair[0].bore, pair[1].law.sonic_conductance)):
        machine = drive(cylinder, valve, stroke, load)
        if max(lp.stroke(machine, "out").time, lp.stroke(machine, "in").time) <= most:
            return cylinder.name, valve.name
    return None


@pytest.mark.parametrize(
    ("stroke", "load", "most"),
    [
        (0.1, lp.Load(mass=5.0), 0.2),
        (0.2, lp.Load(mass=20.0, dry_friction=20.0, stiction=35.0, mounting=math.pi / 2), 0.6),
        (0.05, lp.Load(mass=0.5, force=-30.0), 0.05),
        (0.5, lp.Load(mass=200.0, viscous_damping=200.0), 0.9),
    ],
)
def test_the_answer_is_that_of_trying_every_pair(stroke, load, most):
    parts = lp.catalogue().of_kind("5/2")
    found = design.size(stroke, load, most, SUPPLY)
    assert found.is_found
    assert (found.best.cylinder.name, found.best.valve.name) == enumerated(parts, stroke, load, most)
    again = drive(found.best.cylinder, found.best.valve, stroke, load)
    assert found.best.strokes["out"].time == pytest.approx(lp.stroke(again, "out").time, rel=1e-12)


def test_no_stroke_is_faster_than_the_bound_that_leaves_pairs_out():
    rng = np.random.default_rng(3)
    parts = lp.catalogue().of_kind("5/2", "5/3 closed", "2 x 3/2")
    followed = 0
    for _ in range(30):
        cylinder = parts.cylinders[rng.integers(len(parts.cylinders))]
        valve = parts.valves[rng.integers(len(parts.valves))]
        push = SUPPLY * math.pi / 4 * cylinder.bore**2
        load = lp.Load(
            mass=float(10 ** rng.uniform(-1, 2)),
            dry_friction=float(rng.uniform(0, 0.1) * push),
            stiction=float(rng.uniform(0.1, 0.2) * push),
            force=float(rng.uniform(-0.2, 0.2) * push),
        )
        for way, times in (("out", (1e3, None)), ("in", (None, 1e3))):
            one = lp.Catalogue(cylinders=(cylinder,), valves=(valve,))
            kinds = ("5/2", "5/3 closed", "2 x 3/2")
            free = design.size(0.1, load, times, SUPPLY, one, kinds=kinds)
            if not free.is_found:
                continue
            time = free.best.strokes[way].time
            # A little more than it takes: it must not be left out.
            near = tuple(None if t is None else 1.001 * time for t in times)
            assert design.size(0.1, load, near, SUPPLY, one, kinds=kinds).is_found
            followed += 1
    assert followed > 30


def test_prices_decide_where_every_part_has_one():
    big, small = (
        lp.CatalogueCylinder(series="S", bore=bore, rod=0.006, price=price)
        for bore, price in ((0.04, 10.0), (0.02, 90.0))
    )
    valves = tuple(
        dataclasses.replace(lp.catalogue().valve(n), price=p) for n, p in (("SMC SY3000", 50), ("SMC SY5000", 20))
    )
    found = design.size(0.1, 2.0, 0.5, SUPPLY, lp.Catalogue(cylinders=(small, big), valves=valves))
    assert (found.best.cylinder, found.best.valve.name) == (big, "SMC SY5000")
    unpriced = dataclasses.replace(small, price=None)
    ranked = cheapest_first((big, unpriced), valves)
    assert [(one.bore, valve.name) for one, valve in ranked][:2] == [(0.02, "SMC SY3000"), (0.02, "SMC SY5000")]


def test_where_none_does_the_nearest_is_the_fastest_there_is():
    parts = lp.catalogue().of_kind("5/2")
    parts = dataclasses.replace(parts, cylinders=parts.cylinders[8:12], valves=parts.valves[:3])
    found = design.size(0.1, 5.0, (0.001, None), SUPPLY, parts)
    assert not found.is_found
    assert len(found.tried) == 12
    load = lp.Load(mass=5.0)
    times = [lp.stroke(drive(c, v, 0.1, load)).time for c in parts.cylinders for v in parts.valves]
    assert found.best.strokes["out"].time == pytest.approx(min(times), rel=1e-12)
    assert "takes" in found.best.remark
    assert "none does" in repr(found)


def test_limits_at_the_stop_are_kept():
    free = design.size(0.1, 20.0, 0.4, SUPPLY)
    soft = design.size(0.1, 20.0, 0.4, SUPPLY, impact_energy=3.0, end_velocity=0.5)
    assert max(one.impact_energy for one in free.best.strokes.values()) > 3.0
    assert soft.is_found
    for one in soft.best.strokes.values():
        assert one.impact_energy <= 3.0
        assert one.end_velocity <= 0.5


def test_a_load_that_no_push_moves_is_named():
    found = design.size(0.1, lp.Load(mass=1.0, stiction=1e6), 0.5, SUPPLY)
    assert not found.is_found
    assert found.best.remark.startswith("the push does not begin the stroke")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"stroke": -0.1}, "stroke"),
        ({"load": 0.0}, "load"),
        ({"time": (None, None)}, "time: found"),
        ({"time": (1.0, 2.0, 3.0)}, "time: found"),
        ({"supply": 9e4}, "supply: found 90000 Pa, expected more than the exhaust pressure"),
        ({"kinds": ("5/4",)}, "kinds: found '5/4', expected one of"),
        ({"kinds": ("3/2",)}, "catalogue: found no valve for both chambers"),
        ({"catalogue": lp.Catalogue(cylinders=(), valves=lp.catalogue().valves)}, "catalogue: found no cylinder"),
        ({"impact_energy": -1.0}, "impact_energy"),
    ],
)
def test_bad_tasks_are_named(change, said):
    task = {"stroke": 0.1, "load": 5.0, "time": 0.5, "supply": SUPPLY} | change
    with pytest.raises(ValueError, match=said):
        design.size(**task)


def test_a_catalogue_tells_what_it_holds():
    parts = lp.catalogue()
    assert len(parts.valves) >= 40
    assert all(part.source for part in (*parts.valves, *parts.cylinders))
    assert next(one.bore for one in parts.cylinders if one.series == "ISO 15552") == 0.032
    assert parts.valve("SMC SY3000").law.sonic_conductance == pytest.approx(1.1e-8)
    assert parts.valve("SMC SX91").opening_delay == pytest.approx(0.01)
    with pytest.raises(ValueError, match="valve: found 'SY'"):
        parts.valve("SY")
    with pytest.raises(ValueError, match="found SMC SY3000 more than once"):
        lp.Catalogue(cylinders=(), valves=(parts.valve("SMC SY3000"),) * 2)
    with pytest.raises(ValueError, match="feeds one chamber"):
        lp.catalogue_drive(
            parts.cylinders[0], parts.valve("SMC SX91"), stroke=0.1, load=lp.Load(mass=1.0), supply_pressure=SUPPLY
        )


@pytest.mark.parametrize("model", ["CKD M4GA1", "CKD M4GA1 5/3 closed", "CKD M3GB1 2 x 3/2", "SMC SY3000"])
def test_a_catalogues_drive_is_that_of_a_file_that_names_its_valve(model):
    valve = lp.catalogue().valve(model)
    text = (
        'name = "x"\nsupply_pressure = "6 bar(g)"\nexhaust_pressure = "0 bar(g)"\n[load]\nmass = "3 kg"\n'
        f'[cylinder]\nbore = "32 mm"\nrod = "12 mm"\nstroke = "100 mm"\nclearance = 0.1\n[valve]\nmodel = "{model}"\n'
    )
    read = parse_machine(text, "x.toml")
    cylinder = lp.catalogue().cylinders[6]
    made = lp.catalogue_drive(cylinder, valve, stroke=0.1, load=lp.Load(mass=3.0), supply_pressure=SUPPLY)
    assert (made.valve, made.more_valves) == (read.valve, read.more_valves)
    assert len(made.flow_paths) == len(read.flow_paths)
    for one, other in zip(made.flow_paths, read.flow_paths, strict=True):
        assert (one.source, one.chamber, one.opening, one.valve) == (
            other.source,
            other.chamber,
            other.opening,
            other.valve,
        )
        assert one.law.sonic_conductance == pytest.approx(other.law.sonic_conductance, rel=1e-12)
    for way in ("out", "in"):
        assert lp.stroke(made, way).time == pytest.approx(lp.stroke(read, way).time, rel=1e-6)


def test_a_pair_whose_start_is_not_held_is_followed_all_the_same():
    # The load pulls it off its stop before the valve switches: no bound on the push tells how far it still has to go.
    valve = lp.catalogue().valve("SMC SY3000")
    parts = lp.Catalogue(cylinders=lp.catalogue().cylinders[6:7], valves=(valve,))
    load = lp.Load(mass=200.0, force=600.0)
    found = design.size(0.1, load, (0.05, None), SUPPLY, parts)
    assert set(found.best.strokes) == {"out"}
    assert found.best.strokes["out"].start_position > 0.05
