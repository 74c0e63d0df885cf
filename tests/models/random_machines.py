"""Machines drawn at random: single- and double-acting, with and without springs, stops, friction, rods and leakage."""

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
