"""PyOpenGL's OSMesa platform on the library that the wheel of `extremal[gl]` carries."""

import ctypes
import os

from OpenGL.platform.osmesa import OSMesaPlatform


class WheelOSMesaPlatform(OSMesaPlatform):
    """Loads libOSMesa from the path that `extremal.sim.gl` found; global, so that MuJoCo's loader sees its symbols."""

    GL = OSMesa = ctypes.CDLL(os.environ["EXTREMAL_OSMESA"], ctypes.RTLD_GLOBAL)
