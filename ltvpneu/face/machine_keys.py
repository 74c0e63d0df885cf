"""Every table and key of a machine file, with what it holds and says: the reader, the schema and `new` read it here."""

from typing import NamedTuple

from ltvpneu.face.units import Dimension
from ltvpneu.models.machine.connections import COLLAPSES
from ltvpneu.models.machine.directional import DIRECTIONAL

SCHEMA = 1
"""Version of the file's keys: what `schema = 1` in a file means."""

Kind = Dimension | type
"""A dimension, or `str`, `bool`, `int`, `dict` (a table) or `list`."""


class Key(NamedTuple):
    """A key of a table."""

    kind: Kind
    says: str
    """What it is, in a line."""
    required: bool = False
    example: str = ""
    """As TOML; where empty, that of its dimension."""
    choices: tuple[str, ...] = ()
    """The words that it may be, where it is one of some."""
    table: str = ""
    """The table, or kind of entry, that it holds."""


MACHINE = {
    "schema": Key(int, "version of this file's keys", example="1"),
    "name": Key(str, "what tables and pictures call the machine", True, '"My drive"'),
    "source": Key(str, "where the numbers are from", example='"catalog page 12"'),
    "supply_pressure": Key("pressure", "absolute, or gauge with (g)", True, '"6 bar(g)"'),
    "exhaust_pressure": Key("pressure", "absolute, or gauge with (g)", True, '"0 bar(g)"'),
    "ambient_pressure": Key("pressure", "of the air around, absolute; gauge pressures count from it",
                            example='"1.013 bar"'),
    "collapse": Key(str, "of a rotary valve's inner volumes", example='"minimum"', choices=COLLAPSES),
    "gas": Key(dict, "the medium, where it is a gas", table="gas"),
    "liquid": Key(dict, "the medium, where it is a liquid", table="liquid"),
    "cylinder": Key(dict, "by bore and stroke, or by areas and volumes", table="cylinder"),
    "load": Key(dict, "what the piston moves", table="load"),
    "valve": Key(dict, "what switches", True, table="valve"),
    "flow_paths": Key(list, "restrictions beside the valve's own", table="flow_path"),
    "volumes": Key(list, "rigid volumes: tanks, grippers; without a cylinder, all there is", table="rigid_volume"),
    "more_valves": Key(list, "further valves, for flow paths that name them by number", table="on_off"),
}  # fmt: skip
GAS = {
    "heat_capacity_ratio": Key("number", "air: 1.4", example="1.4"),
    "specific_gas_constant": Key("gas constant", "air: 287.05 J/(kg K)"),
    "temperature": Key("temperature", "of the supply and the surroundings"),
}
REAL_GAS = {
    "fluid": Key(str, "name of a fluid in CoolProp", True, '"Air"'),
    "temperature": Key("temperature", "of the supply and the surroundings"),
    "pressure_range": Key(list, "where the gas is tabled", example='["0.5 bar", "12 bar"]'),
    "temperature_range": Key(list, "where the gas is tabled", example='["220 K", "400 K"]'),
}
LIQUID = {
    "density": Key("density", "at the reference pressure"),
    "bulk_modulus": Key("pressure", "of the liquid without gas", example='"1.4 GPa"'),
    "bulk_modulus_slope": Key("number", "rise of the bulk modulus over the pressure", example="10.0"),
    "entrained_gas": Key("number", "share of the volume at the reference pressure", example="0.005"),
    "gas_exponent": Key("number", "polytropic exponent of the entrained gas", example="1.4"),
    "viscosity": Key("viscosity", "dynamic"),
    "critical_reynolds_number": Key("number", "at which flow through an orifice turns turbulent", example="150.0"),
    "vapor_pressure": Key("pressure", "below which it cavitates", example='"2 kPa"'),
    "reference_pressure": Key("pressure", "of density and entrained gas", example='"1.013 bar"'),
    "temperature": Key("temperature", "for information: a liquid's is no state"),
}
ENERGY_BALANCE = {
    "heat_transfer_coefficient": Key("heat transfer coefficient", "between gas and wall"),
    "wall_area": Key("area", "that exchanges heat"),
    "wall_temperature": Key("temperature", "by default that of the medium"),
}
INNER_VOLUME = {
    "name": Key(str, "of the ports' volume that it is"),
    "volume": Key("volume", "its size", True),
    "polytropic_exponent": Key("number", "1 isothermal, 1.4 adiabatic", example="1.0"),
    "energy_balance": Key(dict, "instead of an exponent", table="energy_balance"),
}
RIGID_VOLUME = {
    "name": Key(str, "by which flow paths lead to it", True, '"tank"'),
    "volume": Key("volume", "its size", True, '"0.5 l"'),
    "polytropic_exponent": Key("number", "1 isothermal, 1.4 adiabatic", example="1.0"),
    "energy_balance": Key(dict, "instead of an exponent", table="energy_balance"),
}
TUBE = {
    "length": Key("length", "of the tube", True, '"1 m"'),
    "inner_diameter": Key("length", "of the tube", True, '"4 mm"'),
    "friction_factor": Key("number", "of Darcy's law", example="0.02"),
}
_WALL = '{ heat_transfer_coefficient = "60 W/(m^2 K)", wall_area = "60 cm^2", wall_temperature = "20 degC" }'
PROCESS = {
    "polytropic_exponent_1": Key("number", "of chamber 1: 1 isothermal, 1.4 adiabatic", example="1.0"),
    "polytropic_exponent_2": Key("number", "of chamber 2", example="1.0"),
    "energy_balance_1": Key(dict, "instead of an exponent: the temperature of chamber 1 is a state",
                            example=_WALL, table="energy_balance"),
    "energy_balance_2": Key(dict, "of chamber 2", example=_WALL, table="energy_balance"),
    "seal_friction_area": Key("area", "C_p, a change of area by the seals", example='"0 mm^2"'),
}  # fmt: skip
BORE_CYLINDER = {
    "bore": Key("length", "diameter of the piston", True, '"32 mm"'),
    "rod": Key("length", "diameter of the rod, on the side of chamber 2", example='"12 mm"'),
    "stroke": Key("length", "position 0 is the rod in, `stroke` the rod out, with a stop at either end", True,
                  '"100 mm"'),
    "rodless": Key(bool, "no rod", example="false"),
    "through_rod": Key(bool, "the rod leaves through both ends", example="false"),
    "acting": Key(str, 'which chambers there are: "push" 1 alone, "pull" 2 alone', example='"double"',
                  choices=("double", "push", "pull")),
    "clearance": Key("number", "volume left at the ends, as a share of the swept volume", example='"10 %"'),
    "dead_volume_1": Key("volume", "left in chamber 1 with the rod in, instead of clearance"),
    "dead_volume_2": Key("volume", "left in chamber 2 with the rod out, instead of clearance"),
    "tube_1": Key(dict, "from the valve to chamber 1: adds its volume and its resistance", table="tube",
                  example='{ length = "1 m", inner_diameter = "4 mm" }'),
    "tube_2": Key(dict, "from the valve to chamber 2", table="tube",
                  example='{ length = "1 m", inner_diameter = "4 mm" }'),
    "mounting": Key("angle", 'way out above the horizontal: "horizontal", "up", "down" or an angle',
                    example='"horizontal"', choices=("horizontal", "up", "down")),
    "return_spring": Key(list, "its two forces: rod in, rod out; towards the rod in", example='["30 N", "60 N"]'),
    **PROCESS,
}  # fmt: skip
CYLINDER = {
    "piston_area_1": Key("area", "of chamber 1, which moves the piston to higher positions", True),
    "piston_area_2": Key("area", "of chamber 2", True),
    "dead_volume_1": Key("volume", "of chamber 1 at position zero; left out where that side is open to the ambient"),
    "dead_volume_2": Key("volume", "of chamber 2 at position zero; likewise"),
    "lower_stop": Key("length", "position of the lower end stop", example='"-50 mm"'),
    "upper_stop": Key("length", "position of the upper end stop", example='"50 mm"'),
    "rod_area_1": Key("area", "of a rod through the end of chamber 1"),
    "rod_area_2": Key("area", "of a rod through the end of chamber 2"),
    "mounting": Key("angle", 'way to higher positions above the horizontal: "horizontal", "up", "down" or an angle',
                    example='"horizontal"', choices=("horizontal", "up", "down")),
    **PROCESS,
}  # fmt: skip
LOAD = {
    "mass": Key("mass", "that moves, with piston and rod", True, '"3 kg"'),
    "spring_stiffness": Key("stiffness", "of a spring on the piston", example='"2 N/mm"'),
    "spring_preload": Key("force", "of the spring at position zero, towards lower positions", example='"30 N"'),
    "viscous_damping": Key("damping", "of seals and guides", example='"40 N s/m"'),
    "dry_friction": Key("force", "in motion", example='"20 N"'),
    "stiction": Key("force", "that holds a piston at rest, not below dry friction", example='"35 N"'),
    "friction_area_1": Key("area", "growth of both with the pressure in chamber 1", example='"9 mm^2"'),
    "friction_area_2": Key("area", "growth of both with the pressure in chamber 2", example='"9 mm^2"'),
    "force": Key("force", "towards higher positions, beside the weight", example='"0 N"'),
}  # fmt: skip
LAW = {
    "sonic_conductance": Key("sonic conductance", "C of ISO 6358"),
    "critical_pressure_ratio": Key("number", "b of ISO 6358", example="0.3"),
    "subsonic_index": Key("number", "m of ISO 6358", example="0.5"),
    "laminar_ratio": Key("number", "ratio of pressures from which on flow is laminar", example="0.999"),
    "cracking_pressure": Key("pressure", "at which a check valve opens", example='"0.2 bar"'),
    "nominal_flow": Key("volume flow", "qNn, 6 to 5 bar gauge, instead of C"),
    "Kv": Key("number", "flow of water [m^3/h] at a drop of 1 bar, instead of C", example="0.15"),
    "Cv": Key("number", "flow of water [US gal/min] at a drop of 1 psi, instead of C", example="0.17"),
}
AREA = {
    "area": Key("area", "of nozzles, instead of C; of a liquid's orifices"),
    "discharge_coefficient": Key("number", "of the area", example="0.8"),
}
SWITCHING = {
    "duty": Key("number", "commanded on-time over period", example="0.5"),
    "start": Key("angle", "of the turn at which it is told to go on", example='"0 deg"'),
    "pulses": Key(list, "on from angle to angle, instead of duty", example='[["0 deg", "60 deg"]]'),
    "ramp": Key("angle", "of the turn over which it opens and closes, instead of times", example='"0 deg"'),
    "opening_delay": Key("time", "from the command until the spool moves", example='"12 ms"'),
    "closing_delay": Key("time", "from the end of the command until the spool moves", example='"18 ms"'),
    "opening_time": Key("time", "of the spool's way", example='"3 ms"'),
    "closing_time": Key("time", "of the spool's way back", example='"3 ms"'),
    "shortest_on": Key("time", "shortest command that the maker allows", example='"5 ms"'),
    "shortest_off": Key("time", "shortest pause that the maker allows", example='"5 ms"'),
}
VALVE = {
    "type": Key(str, "ports / positions", True, '"5/2"', choices=DIRECTIONAL),
    "model": Key(str, "a bundled valve: `ltvpneu machines` lists them; keys beside it win", example='"SMC SY3000"'),
    **LAW,
    **AREA,
    "exhaust": Key(dict, "from a chamber to the exhaust, where that is other than from the supply", table="law",
                   example='{ sonic_conductance = "0.8 dm^3/(s bar)", critical_pressure_ratio = 0.25 }'),
    "silencer": Key(dict, "behind the exhaust ports", table="law",
                    example='{ sonic_conductance = "0.5 dm^3/(s bar)", critical_pressure_ratio = 0.3 }'),
    "chamber": Key(str, "on which a valve with one outlet works: chamber_1, chamber_2 or a rigid volume",
                   example='"chamber_1"'),
    "second": Key(dict, "of a valve of two coils: how the second is switched", table="coil",
                  example='{ duty = 0.5, start = "180 deg" }'),
    **SWITCHING,
}  # fmt: skip
COIL = dict(SWITCHING)
ON_OFF = {"type": Key(str, '"on_off": its flow paths are listed', True, '"on_off"'), **SWITCHING}
PROPORTIONAL = {
    "type": Key(str, '"proportional": its paths open as its command says', True, '"proportional"'),
    "command": Key(list, "angles of the turn, and openings from -1 to 1", True,
                   '[["0 deg", 1.0], ["180 deg", -1.0]]'),
}  # fmt: skip
ROTARY = {
    "type": Key(str, '"rotary": ports of a sleeve that turns once a period', True, '"rotary"'),
    "offset_angle": Key("angle", "between stator and housing"),
    "duty": Key("number", "instead of the ports' geometry", example="0.5"),
    "pulses": Key(list, "on from angle to angle, likewise", example='[["0 deg", "60 deg"]]'),
    "ports": Key(list, "its ports", True, table="port"),
    "inner_volumes": Key(list, "sizes of its inner volumes", table="inner_volume"),
}
PORT = {
    "way": Key(str, "what it leads to", True, '"supply"'),
    "area": Key("area", "when fully uncovered", True),
    "discharge_coefficient": Key("number", "of the port", True, "0.65"),
    "opens_at": Key("angle", "at which it begins to open", True, '"0 deg"'),
    "open_for": Key("angle", "over which it is uncovered", True),
    "ramp": Key("angle", "over which its edge passes", example='"0 deg"'),
    "volume": Key(str, "inner volume that it opens to", example='"valve"'),
    "turns_with_offset": Key(bool, "whether the offset angle turns it", example="false"),
    "phase": Key(str, "which part of the turn it gets with a duty", example='"on"', choices=("on", "off", "always")),
}
FLOW_PATH = {
    "source": Key(str, '"supply", "exhaust" or the other chamber', True, '"exhaust"'),
    "chamber": Key(str, "that it leads to", True, '"chamber_1"'),
    **AREA,
    **LAW,
    "back": Key(dict, "flow from the chamber to the source, where that is other", table="law",
                example='{ sonic_conductance = "0 dm^3/(s bar)" }'),
    "in_series": Key(dict, "a fixed restriction on the side of the source: silencer, throttle", table="law",
                     example='{ sonic_conductance = "0.5 dm^3/(s bar)" }'),
    "opening": Key(str, "when it is open", example='"always"', choices=("always", "on", "off")),
    "opens_at": Key("angle", "of the turn, with open_for, instead of `opening`"),
    "open_for": Key("angle", "of the turn"),
    "ramp": Key("angle", "of that window", example='"0 deg"'),
    "valve": Key(int, "which valve opens it: 0 the valve, 1 the first of more_valves", example="0"),
}  # fmt: skip

TABLES: dict[str, dict[str, Key]] = {
    "machine": MACHINE,
    "gas": GAS,
    "real_gas": REAL_GAS,
    "liquid": LIQUID,
    "energy_balance": ENERGY_BALANCE,
    "inner_volume": INNER_VOLUME,
    "rigid_volume": RIGID_VOLUME,
    "tube": TUBE,
    "bore_cylinder": BORE_CYLINDER,
    "cylinder": CYLINDER,
    "load": LOAD,
    "law": LAW,
    "valve": VALVE,
    "coil": COIL,
    "on_off": ON_OFF,
    "proportional": PROPORTIONAL,
    "rotary": ROTARY,
    "port": PORT,
    "flow_path": FLOW_PATH,
}
"""All of them by name. `cylinder` and `valve` have other keys by what they begin with: see `ALTERNATIVES`."""
ALTERNATIVES = {
    "cylinder": ("bore_cylinder", "cylinder"),
    "valve": ("valve", "on_off", "proportional", "rotary"),
    "on_off": ("on_off", "proportional"),
    "gas": ("gas", "real_gas"),
}
"""What a table may be instead."""
