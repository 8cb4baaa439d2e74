"""PyOpenGL's OSMesa platform on the library that the wheel of `extremal[gl]` carries."""

import os

from OpenGL.platform.osmesa import OSMesaPlatform

from extremal.sim.gl_probe import load_bundled


class WheelOSMesaPlatform(OSMesaPlatform):
    """Loads libOSMesa from the path that `extremal.sim.gl` found; global, so that MuJoCo's loader sees its symbols."""

    GL = OSMesa = load_bundled(os.environ["EXTREMAL_OSMESA"])  # pyright: ignore[reportAssignmentType]
