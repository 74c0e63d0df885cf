"""Machines drawn at random: single- and double-acting, with and without springs, stops, friction, rods and leakage."""

from dataclasses import replace

import numpy as np

import ltvpneu as lp


def random_machine(rng: np.random.Generator) -> tuple[lp.Machine, float]:
    """Return a machine and a frequency [Hz]; what it drives, and how fast, spans what drives on a bench do."""
    area, stroke = 10 ** rng.uniform(-4, -2.7), rng.uniform(0.03, 0.2)
    other, is_double = area * rng.uniform(0.7, 1.0), rng.random() < 0.6
    exhaust, span = rng.uniform(0.9e5, 2.5e5), 10 ** rng.uniform(5, 5.8)
    push, has_stops = span * area, rng.random() < 0.7
    mass = 10 ** rng.uniform(-1, 1)
    stiffness = 0.0 if has_stops and rng.random() < 0.4 else push / stroke * rng.uniform(0.5, 2.0)
    dry = 0.0 if rng.random() < 0.4 else push * rng.uniform(0.01, 0.15)
    low = -stroke * rng.uniform(0.2, 0.8)
    cylinder = lp.Cylinder(
        piston_area_1=area,
        piston_area_2=other,
        dead_volume_1=area * stroke * rng.uniform(0.9, 1.5),
        dead_volume_2=other * stroke * rng.uniform(1.1, 1.6) if is_double else None,
        polytropic_exponent_1=1.0 if rng.random() < 0.6 else rng.uniform(1.05, 1.4),
        polytropic_exponent_2=1.0 if rng.random() < 0.6 else rng.uniform(1.05, 1.4),
        lower_stop=low if has_stops else -np.inf,
        upper_stop=low + stroke if has_stops else np.inf,
        rod_area_1=None if rng.random() < 0.7 else area * rng.uniform(0.0, 0.2),
    )
    load = lp.Load(
        mass=mass,
        spring_stiffness=stiffness,
        viscous_damping=rng.uniform(0.1, 1.0) * np.sqrt(mass * push / stroke),
        dry_friction=dry,
        stiction=dry * rng.uniform(1.0, 2.0),
        force=push * rng.uniform(-0.2, 0.2),
    )
    opening = area * 10 ** rng.uniform(-2.8, -1.8)
    paths = [
        lp.FlowPath(source=source, chamber=f"chamber_{k}", area=opening * rng.uniform(0.5, 2.0), opening=phase)
        for k, phases in ((1, ("on", "off")), (2, ("off", "on")))[: 2 if is_double else 1]
        for source, phase in zip(("supply", "exhaust"), phases, strict=True)
    ]
    machine = lp.Machine(
        name="Random",
        supply_pressure=exhaust + span,
        exhaust_pressure=exhaust,
        ambient_pressure=rng.uniform(0.7e5, 1.1e5),
        cylinder=cylinder,
        load=load,
        valve=lp.OnOffValve(duty=rng.uniform(0.1, 0.9), ramp=0.0 if rng.random() < 0.5 else 0.3),
        flow_paths=tuple(paths),
    )
    return machine, 10 ** rng.uniform(-0.3, 1.5)


def random_kind(rng: np.random.Generator) -> tuple[lp.Machine, float]:
    """Return a machine of any kind and a frequency [Hz]: valves, volumes, processes, media's ratios of pressures."""
    machine, _ = random_machine(rng)
    exhaust = machine.exhaust_pressure
    ratio = 1.0 + 10 ** rng.uniform(-2, 1.28)
    cylinder, load = machine.cylinder, machine.load
    push = (ratio - 1) * exhaust * cylinder.piston_area_1
    scale = push / ((machine.supply_pressure - exhaust) * cylinder.piston_area_1)
    dry = push * rng.choice([0.0, rng.uniform(0.01, 0.15), rng.uniform(0.3, 0.6)], p=[0.3, 0.5, 0.2])
    load = replace(
        load,
        spring_stiffness=load.spring_stiffness * scale,
        dry_friction=dry,
        stiction=dry * rng.uniform(1.0, 2.0),
        force=push * rng.uniform(-0.2, 0.2),
    )
    if rng.random() < 0.25:
        wall = lp.EnergyBalance(
            heat_transfer_coefficient=10 ** rng.uniform(0, 2), wall_area=1e-2, wall_temperature=293.15
        )
        cylinder = replace(cylinder, energy_balance_1=wall, polytropic_exponent_1=1.0)
    paths, valve, more, collapse = machine.flow_paths, machine.valve, (), "minimum"
    if rng.random() < 0.35:
        opening = paths[0].area
        ports = tuple(
            lp.Port(
                way=way,
                area=opening * rng.uniform(1.0, 4.0),
                discharge_coefficient=rng.uniform(0.4, 1.0),
                window=lp.Window(
                    start=rng.uniform(0, 1), width=rng.uniform(2.0, 4.0), ramp=rng.choice([0.0, rng.uniform(0.1, 0.9)])
                ),
                turns_with_offset=way != "supply",
            )
            for way in ("supply", "chamber_1")
        )
        collapse = str(rng.choice(["minimum", "in_series", "dynamic"]))
        volumes = (lp.InnerVolume(volume=cylinder.dead_volume_1 * 10 ** rng.uniform(-2, -0.5)),)
        valve = lp.RotaryValve(
            ports=ports, offset_angle=rng.uniform(-1.0, 1.0), inner_volumes=volumes if collapse == "dynamic" else ()
        )
        out = lp.FlowPath(source="exhaust", chamber="chamber_1", area=opening * rng.uniform(0.2, 1.0))
        paths, cylinder = (out,), replace(cylinder, dead_volume_2=None, energy_balance_2=None)
    else:
        count = int(rng.integers(1, 4))
        duty = float(rng.choice([0.0, 1.0, rng.uniform(0.05, 0.95)], p=[0.05, 0.05, 0.9]))
        valve = lp.OnOffValve(duty=duty, ramp=0.0 if rng.random() < 0.5 else rng.uniform(0.05, 0.5))
        if count > 1 and 0.0 < duty < 1.0:
            starts = 2 * np.pi * np.arange(count) / count
            machine = replace(machine, valve=replace(valve, ramp=0.0))
            valve = machine.with_pulses([(float(s), float(s + 2 * np.pi * duty / count)) for s in starts]).valve
        if rng.random() < 0.3:
            leak = lp.FlowPath(source="exhaust", chamber="chamber_1", area=paths[0].area * 10 ** rng.uniform(-3, -1))
            paths = (*paths, leak)
        if rng.random() < 0.2 and len(paths) > 2:
            more = (lp.OnOffValve(duty=rng.uniform(0.1, 0.9), start=rng.uniform(0.0, 6.0)),)
            paths = tuple(replace(p, valve=1) if p.chamber == "chamber_2" else p for p in paths)
    machine = replace(
        machine,
        supply_pressure=ratio * exhaust,
        ambient_pressure=exhaust,
        cylinder=cylinder,
        load=load,
        valve=valve,
        more_valves=more,
        flow_paths=paths,
        collapse=collapse,
    )
    return machine, 10 ** rng.uniform(-1, 2.3)
