"""What `ltvpneu drive` prints and draws: a drive on one screen."""

import math
from typing import TYPE_CHECKING

from ltvpneu.face.results import Results
from ltvpneu.face.tables import heading, table
from ltvpneu.face.units import pressure_shown
from ltvpneu.models.cycles.data_sheet import AirUse, DataSheet, Switching
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.stroke import Stroke
from ltvpneu.physics.iso6358 import ANR_DENSITY

if TYPE_CHECKING:
    pass


def drive_text(sheet: DataSheet) -> str:
    """Return the screen."""
    parts = [sketch(sheet.machine), heading("Strokes, from stop to stop"), strokes_table(sheet)]
    if sheet.air is not None:
        parts += [heading("Air"), air_text(sheet.air)]
    if sheet.switching is not None:
        title = heading(f"Switched at {sheet.switching.frequency:.4g} Hz")
        parts += [title, switching_text(sheet.switching, sheet.air is not None)]
    if sheet.remarks:
        parts += ["", *(f"! {remark}" for remark in sheet.remarks)]
    return "\n".join(parts) + "\n"


def sketch(machine: Machine) -> str:
    """Return the cylinder with its chambers, where position is zero and which way it grows."""
    cylinder = machine.cylinder
    low, high = 1e3 * cylinder.lower_stop, 1e3 * cylinder.upper_stop
    one = "chamber 1" if cylinder.dead_volume_1 is not None else "open     "
    two = "chamber 2" if cylinder.dead_volume_2 is not None else "open     "
    up = math.degrees(machine.load.mounting)
    lies = "lies flat" if up == 0 else f"its way out rises by {up:.4g} deg"
    rods = cylinder.rod_areas
    left, right = ("====" if rods[0] > 0 else "    "), ("========" if rods[1] > 0 else "        ")
    around = machine.ambient_pressure
    supply, exhaust = (pressure_shown(p, around) for p in (machine.supply_pressure, machine.exhaust_pressure))
    zero = "at the lower stop" if low == 0 else "between the stops"
    return f"""{machine.name}

        +-----------+--+---------------+
   {left} | {one} |##| {two}     {right}    position 0 {zero}, growing to the right
        +-----------+--+---------------+             from {low:.4g} to {high:.4g} mm; {lies}
          p1, A1            p2, A2

  areas {1e4 * cylinder.piston_area_1:.4g} and {1e4 * cylinder.piston_area_2:.4g} cm²; moving mass \
{machine.load.mass:.4g} kg
  supply {supply}, exhaust {exhaust}"""


def strokes_table(sheet: DataSheet) -> str:
    """Return both strokes."""
    drawn = "air [Nl]" if sheet.air is not None else "drawn [kg]"
    header = ["stroke", "time [ms]", "delay before [ms]", "moves after [ms]", "at the stop [m/s]", "impact [J]",
              "greatest force [N]", drawn]  # fmt: skip
    return table(header, [_stroke_row(name, one, sheet.air is not None) for name, one in sheet.strokes.items()])


def _stroke_row(name: str, one: Stroke, is_air: bool) -> list[str]:
    air = f"{1e3 * one.air_mass / ANR_DENSITY:.3f}" if is_air else f"{one.air_mass:.4f}"
    return [
        name,
        f"{1e3 * one.time:.1f}" if one.arrives else "-",
        f"{1e3 * one.delay:.4g}",
        f"{1e3 * one.first_motion:.1f}" if math.isfinite(one.first_motion) else "-",
        f"{one.end_velocity:.3f}" if one.arrives else "-",
        f"{one.impact_energy:.3f}" if one.arrives else "-",
        f"{one.greatest_force:.1f}",
        air,
    ]


def air_text(air: AirUse) -> str:
    """Return what a double stroke takes."""
    lines = [f"  a double stroke    {1e3 * air.volume:.3f} normal litres (ANR), {1e3 * air.mass:.3f} g"]
    if math.isfinite(air.double_stroke_time):
        lines += [
            f"  without a pause    {1e3 * air.volume_per_minute:.1f} Nl/min, {air.air_power:.0f} W of air power, "
            f"{air.cost_per_hour:.3f} an hour at {air.price:g} a normal cubic metre",
            f"  efficiency         {100 * air.efficiency:.1f} % of the air's exergy is work on the piston, friction "
            "and impact included",
        ]
    return "\n".join(lines)


def switching_text(found: Switching, is_air: bool) -> str:
    """Return what duties do at a frequency."""
    low, high = found.duty_band
    orbits = found.orbits
    rows = [
        [
            f"{duty:.3f}",
            f"{1e3 * mean:.2f}" if math.isfinite(mean) else "-",
            f"{2e3 * ripple:.2f}" if math.isfinite(ripple) else "-",
            _flow_shown(flow, is_air),
            kind,
        ]
        for duty, mean, ripple, flow, kind in zip(
            orbits.duties, orbits.means[0], orbits.amplitudes[0], found.mass_flows, orbits.kinds[0], strict=True
        )
    ]
    drawn = "air [Nl/min]" if is_air else "drawn [kg/min]"
    lines = [
        f"  usable duty        {low:.3f} to {high:.3f}; beyond, the valve's times leave it shut, or open",
        table(["duty", "mean position [mm]", "ripple, peak to peak [mm]", drawn, "remark"], rows),
        f"  balance            {_balance(found)}",
        f"  switches           {found.switches_per_hour:.4g} an hour"
        + ("" if math.isnan(found.shortest_life) else f"; the valve lasts {found.shortest_life:.0f} hours"),
    ]
    return "\n".join(lines)


def _flow_shown(flow: float, is_air: bool) -> str:
    if not math.isfinite(flow):
        return "-"
    return f"{6e4 * flow / ANR_DENSITY:.1f}" if is_air else f"{60 * flow:.2f}"


def _balance(found: Switching) -> str:
    if math.isnan(found.balance_duty):
        return "no duty balances the load with the piston at mid-stroke"
    share = found.balance_open_share
    return f"at mid-stroke with duty {found.balance_duty:.3f}, the valve open for {share:.3f} of the period"


def write_drive(sheet: DataSheet, results: Results) -> None:
    """Write the pictures."""
    # A lazy door: matplotlib takes longer to load than the strokes to run.
    from ltvpneu.face.drive_pictures import draw_strokes, draw_switching, draw_work

    results.picture("strokes", draw_strokes(sheet), dpi=120)
    if sheet.switching is None:
        results.picture("work", draw_work(sheet), dpi=120)
    else:
        results.picture("duty", draw_switching(sheet.switching), dpi=120)
