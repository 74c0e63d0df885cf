"""Laws of gas, flow, valve, cylinder, friction and load, each written once."""
