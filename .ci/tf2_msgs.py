"""Makes tf2_msgs, the one package of messages that there is no wheel of, for the ROS 2 whose Python runs this.

ROS' own generators write it, as its CMake would have them do; one call of the compiler for each file makes an extension
of Python of all of them, without CMake and the twenty packages that it needs.
"""

import json
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import numpy
from rosidl_generator_c import generate_c
from rosidl_generator_py import generate_py
from rosidl_generator_type_description import generate_type_hash
from rosidl_typesupport_c import generate_c as generate_dispatch
from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c
from rosidl_typesupport_introspection_c import generate_c as generate_introspection

IDL = """#include "geometry_msgs/msg/TransformStamped.idl"
module tf2_msgs { module msg { struct TFMessage { sequence<geometry_msgs::msg::TransformStamped> transforms; }; }; };
"""
NEEDED = "geometry_msgs", "std_msgs", "builtin_interfaces"
BY_NAME = "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"
"""What ROS looks for in a library of its own."""
KINDS = "rosidl_generator_c", "rosidl_generator_py", "rosidl_typesupport_c", *BY_NAME
PREFIX, SITE = Path(sys.prefix), Path(sysconfig.get_path("purelib"))


def generate(work: Path) -> None:
    """Writes the sources below `work/tf2_msgs`."""
    (work / "msg").mkdir()
    (work / "msg" / "TFMessage.idl").write_text(IDL)
    (work / "msg" / "TFMessage.msg").write_text("geometry_msgs/TransformStamped[] transforms\n")
    told = work / "told.json"

    def run(package, generator, *more, **given):
        common = {
            "package_name": "tf2_msgs",
            "output_dir": str(work / "tf2_msgs"),
            "template_dir": str(PREFIX / "share" / package / "resource"),
            "idl_tuples": [f"{work}:msg/TFMessage.idl"],
            "ros_interface_files": [str(work / "msg" / "TFMessage.msg")],
            "ros_interface_dependencies": [],
            "target_dependencies": [],
        }
        told.write_text(json.dumps(common | given))
        generator(str(told), *more)

    shares = [f"{name}:{PREFIX / 'share' / name}" for name in NEEDED]
    run("rosidl_generator_type_description", generate_type_hash, include_paths=shares)
    described = [f"msg/TFMessage.idl:{work}/tf2_msgs/msg/TFMessage.json"]
    run("rosidl_generator_c", generate_c, type_description_tuples=described)
    run("rosidl_typesupport_fastrtps_c", generate_typesupport_fastrtps_c)
    run("rosidl_typesupport_introspection_c", generate_introspection)
    run("rosidl_typesupport_c", generate_dispatch, BY_NAME)
    run("rosidl_generator_py", generate_py, ["rosidl_typesupport_c"])
    for header in (PREFIX / "share").glob("rosidl_*_c/resource/*__visibility_control.h.in"):
        text = header.read_text().replace("@PROJECT_NAME@", "tf2_msgs")
        text = text.replace("@PROJECT_NAME_UPPER@", "TF2_MSGS")
        (work / "tf2_msgs" / "msg" / header.stem).write_text(text)


def build(work: Path) -> Path:
    """One library of all sources."""
    folders = [work, PREFIX / "include", *(PREFIX / "include").iterdir()]
    includes = [*folders, sysconfig.get_path("include"), numpy.get_include()]
    running = []
    for source in (work / "tf2_msgs").rglob("*.c*"):
        compiler = ["g++", "-std=c++17"] if source.suffix == ".cpp" else ["gcc", "-std=c11"]
        compiler += ["-w", "-fPIC", "-c", *(f"-I{each}" for each in includes)]
        running.append(subprocess.Popen([*compiler, str(source), "-o", f"{source}.o"]))
    if any(each.wait() for each in running):
        raise SystemExit("tf2_msgs could not be compiled")
    libraries = [f"-l{package}__{kind}" for package in NEEDED for kind in KINDS]
    libraries += [f"-l{name}" for name in ("rosidl_runtime_c", "rosidl_typesupport_c", *BY_NAME, "fastcdr")]
    library, objects = work / "library.so", map(str, (work / "tf2_msgs").rglob("*.o"))
    subprocess.run(
        ["g++", "-shared", *objects, f"-L{PREFIX}/lib", *libraries, "-o", str(library)], check=True
    )
    return library


def install(library: Path, work: Path) -> None:
    """The library under each name that it is looked for by, and the classes."""
    shutil.copytree(
        work / "tf2_msgs", SITE / "tf2_msgs", ignore=shutil.ignore_patterns("*.c", "*.cpp", "*.h", "*.o")
    )
    (SITE / "tf2_msgs" / "__init__.py").touch()
    own = shutil.copy(library, SITE / "tf2_msgs" / "tf2_msgs_s__rosidl_typesupport_c.so")
    for name in BY_NAME:  # relative, so that the environment may be moved
        (PREFIX / "lib" / f"libtf2_msgs__{name}.so").symlink_to(own.relative_to(PREFIX / "lib"))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        generate(Path(folder))
        install(build(Path(folder)), Path(folder))
