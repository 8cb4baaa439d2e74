"""What hostile files hold: texts of scenes and tables of poses, bytes of meshes."""

import struct

SPHERE = '[[objects]]\ntype = "sphere"\nradius = 0.05\n'
LATHE = '[[objects]]\ntype = "lathe"\nprofile_z = [0.0, 0.05, 0.1]\nprofile_r = [0.04, 0.03, 0.04]\n'
BOX = '[[objects]]\ntype = "box"\nsize = [0.1, 0.2, 0.3]\n'
ROUNDED = '[[objects]]\ntype = "superquadric"\na = 0.1\nb = 0.1\nc = 0.1\ne1 = 0.5\ne2 = 0.8\n'
PATCH = "[[objects.markings]]\nwidth_deg = 20\nbottom = 0.02\ntop = 0.04\ncolour = 0.9\n"
MESH = '[[objects]]\ntype = "mesh"\nfile = "{}"\n'
OUTSIDE = "outside.stl"

# Texts of scenes.
BIG = "9" * 4000
SCENES: dict[str, str] = {
    "nested arrays": "a = " + "[" * 300_000,
    "nested tables": "a = " + "{a=" * 300_000,
    "nested, closed": "a = " + "[" * 300 + "]" * 300,
    "dotted key": ".".join(["a"] * 400_000) + " = 1",
    "dotted key with spaces": " . ".join(['"a,b"'] * 100_000) + " = 1",
    "dotted header": "[" + ".".join(["a"] * 400_000) + "]",
    "dotted key in a table": "a = {" + ".".join(["'.'"] * 100_000) + " = 1}",
    "many digits": SPHERE.replace("0.05", BIG * 2),
    "many hexadecimal digits": SPHERE.replace("0.05", "0x" + "f" * 9000),
    "many hexadecimal digits in a text's place": SPHERE + "name = 0x" + "f" * 9000,
    "many hexadecimal digits in a list's place": "target = 0x" + "f" * 9000,
    "many hexadecimal digits in a table's place": "objects = [0x" + "f" * 9000 + "]",
    "many digits of a fraction": SPHERE.replace("0.05", "0." + "0" * 900_000 + "1"),
    "huge exponent": SPHERE.replace("0.05", "1e999999999"),
    "many keys": "\n".join(f"a{i} = 1" for i in range(90_000)),
    "many objects": SPHERE * 20_000,
    "many numbers": "target = [" + "0," * 450_000 + "]",
    "too large": "#" * 3_000_000,
    "unclosed text": 'name = "' + '\\"' * 400_000,
    "nan in a list": SPHERE + "position = [0, nan, 0]",
    "nan angle": SPHERE + "rotation_deg = [nan, 0, 0]",
    "huge angle": SPHERE + "rotation_deg = [1e300, 0, 0]",
    "nan colour": SPHERE + "colour = nan",
    "nan light": SPHERE + "[[lights]]\ndirection = [nan, 0, 1]",
    "inf target": SPHERE + "target = [inf, 0, 0]",
    "date": SPHERE.replace("0.05", "2020-01-01"),
    "lone surrogate": SPHERE + 'name = "\\ud800"',
    "control character": SPHERE + 'name = "\\u0000"',
    "tags in a name": SPHERE + 'name = "<script>"',
    "flat profile": LATHE.replace("0.05, 0.1", "1e-9, 2e-9"),
    "endless profile": LATHE.replace("[0.0, 0.05, 0.1]", "[" + "0,1," * 5000 + "]"),
    "needle": LATHE.replace("[0.04, 0.03, 0.04]", "[100.0, 1e-4, 100.0]"),
    "exponents": ROUNDED.replace("0.5", "1e-300"),
    "exponents of zero": ROUNDED.replace("0.5", "0"),
    "ratio": ROUNDED.replace("a = 0.1", "a = 1e-4").replace("b = 0.1", "b = 100"),
    "far": SPHERE + "position = [1e4, 0, 0]",
    "a hundred lathes": "".join(LATHE + f'name = "{i}"\n' for i in range(100)),
    "mesh absolute": MESH.format("/etc/passwd.stl"),
    "mesh of a device": MESH.format("/dev/zero"),
    "mesh above": MESH.format("../" + OUTSIDE),
    "mesh above, by a detour": MESH.format("a/../../" + OUTSIDE),
    "mesh by a symbolic link": MESH.format("link.stl"),
    "mesh by a linked folder": MESH.format("linked/" + OUTSIDE),
    "mesh by links in a circle": MESH.format("circle.stl"),
    "mesh by a web address": MESH.format("http://localhost:1/ball.stl"),
    "mesh of a null byte": MESH.format("a\\u0000.stl"),
    "mesh of a long name": MESH.format("a" * 300 + ".stl"),
    "mesh of a home folder": MESH.format("~/ball.stl"),
    "mesh scale zero": MESH.format("ball.stl") + "scale = 0",
    "mesh scale tiny": MESH.format("ball.stl") + "scale = 1e-300",
    "mesh scale negative": MESH.format("ball.stl") + "scale = -1",
    "mesh scale nan": MESH.format("ball.stl") + "scale = nan",
    "mesh scale large": MESH.format("ball.stl") + "scale = 1e4",
    "mujoco binary": MESH.format("model.mjb"),
    "mujoco": MESH.format("model.xml"),
    "include": '<mujoco><include file="/etc/passwd"/></mujoco>',
    "replicate": '<mujoco><worldbody><replicate count="100000"><body/></replicate></worldbody></mujoco>',
}

_VERTICES = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
_FACES = b"f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
_PLY = b"ply\nformat %s 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\nelement face %d\n"
_PLY += b"property list %s int vertex_indices\nend_header\n"
# Contents of mesh files, by the suffix after the last space.
MESH_FILES: dict[str, bytes] = {
    "materials obj": b"mtllib /etc/passwd\n" + _VERTICES + b"usemtl x\n" + _FACES,
    "materials from a device obj": b"mtllib /dev/zero\n" + _VERTICES + b"usemtl x\n" + _FACES,
    "many materials obj": _VERTICES + b"".join(b"usemtl m%d\nf 1 2 3\n" % i for i in range(300_000)),
    "index beyond obj": _VERTICES + _FACES.replace(b"4", b"999999999999999999999999"),
    "index negative obj": _VERTICES + _FACES.replace(b"f 1", b"f -9223372036854775808"),
    "nan obj": _VERTICES.replace(b"v 1", b"v nan") + _FACES,
    "inf obj": _VERTICES.replace(b"v 1", b"v 1e999") + _FACES,
    "large obj": _VERTICES.replace(b"1", b"1e300") + _FACES,
    "flat obj": _VERTICES.replace(b"0 0 1", b"0.5 0.5 0") + _FACES,
    "open obj": _VERTICES + _FACES[:-8],
    "inside out obj": _VERTICES + b"f 2 3 1\nf 4 2 1\nf 4 3 2\nf 4 1 3\n",
    "long line obj": b"v " + b"0 " * 20_000_000,
    "polygon obj": _VERTICES + b"f " + b"1 2 3 " * 1_000_000,
    "only vertices obj": b"v 0 0 0\n" * 5_000_000,
    "continued obj": b"v 0 0 \\\n" * 3_000_000,
    "not text obj": bytes(range(256)) * 1000,
    "count stl": bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(1000),
    "many faces stl": bytes(80) + struct.pack("<I", 900_000) + bytes(50 * 900_000),
    "unclosed stl": b"solid x\n" + b"facet normal 0 0 0\n outer loop\n  vertex 0 0 0\n" * 500_000,
    "count ply": _PLY % (b"binary_little_endian", 10**18, 4, b"uchar") + bytes(100),
    "count text ply": _PLY % (b"ascii", 10**12, 10**12, b"uchar") + b"0 0 0\n" * 10,
    "negative count ply": _PLY % (b"binary_little_endian", -5, -4, b"uchar") + bytes(100),
    "list length ply": _PLY % (b"binary_little_endian", 0, 1, b"uint") + b"\xff" * 8,
    "unknown type ply": _PLY % (b"ascii", 4, 4, b"object") + b"0 0 0\n" * 8,
    "texture ply": (_PLY % (b"ascii", 4, 0, b"uchar")).replace(b"1.0\n", b"1.0\ncomment TextureFile /etc/passwd\n")
    + b"0 0 0\n" * 4,
    "endless header ply": b"ply\nformat ascii 1.0\n" + b"element vertex 1\nproperty float x\n" * 1_000_000,
    "count off": b"OFF\n999999999999 999999999999 0\n0 0 0\n",
    "negative count off": b"OFF\n-4 -4 0\n0 0 0\n",
    "face length off": b"OFF\n4 1 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n999999999 0 1 2\n",
    "format glb": b"glTF\x02\x00\x00\x00",
    "format gltf": b'{"buffers": [{"uri": "/etc/passwd"}]}',
    "format dae": b'<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><x>&a;</x>',
    "format 3mf": b"PK\x03\x04",
    "format npy": b"\x93NUMPY",
}  # fmt: skip

_POSES = "image,x,y,z,qx,qy,qz,qw\n"
_ROWS = "".join(f"{i}.png,0.{i},0,0,0,0,0,1\n" for i in range(3))
POSES: dict[str, bytes] = {
    name: (text if isinstance(text, bytes) else text.encode())
    for name, text in {
        "nan": _POSES + _ROWS.replace("0.1", "nan"),
        "inf": _POSES + _ROWS.replace("0.1", "-inf"),
        "huge": _POSES + _ROWS.replace("0.1", "1e400"),
        "digits": _POSES + _ROWS.replace("0.1", "1" * 5000),
        "underscores": _POSES + _ROWS.replace("0.1", "1_000"),
        "zero quaternion": _POSES + _ROWS.replace(",1\n", ",0\n"),
        "tiny quaternion": _POSES + _ROWS.replace(",1\n", ",1e-320\n"),
        "above": _POSES + _ROWS.replace("1.png", "../1.png"),
        "absolute": _POSES + _ROWS.replace("1.png", "/etc/passwd"),
        "null": _POSES + _ROWS.replace("1.png", "\0"),
        "quote": _POSES + '"' + "a" * 9_000_000,
        "wide": _POSES + "," * 9_000_000,
        "long": _POSES + "0\n" * 4_000_000,
        "cell": _POSES + "a" * 200_000 + ",0" * 7,
        "latin": b"\xe9",
        "utf16": (_POSES + _ROWS).encode("utf-16"),
        "columns": _POSES.replace("qw", "qz") + _ROWS,
        "many rows": _POSES + "".join(f"{i}.png,0,0,0,0,0,0,1\n" for i in range(300_000)),
    }.items()
}
