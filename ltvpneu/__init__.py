"""Control design for pneumatic actuators switched by on-off valves, on python-control.

The names below are those of `__init__.pyi`; each loads its module when it is first asked for.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
