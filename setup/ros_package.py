"""Builds every ROS package alike: package.xml describes it, its modules with a `main` are its executables."""

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

from setuptools import find_packages, setup


def setup_ros_package() -> None:
    """Set up the package in the current folder, called from its setup.py by colcon or pip."""
    description = ElementTree.parse("package.xml").getroot()
    name = description.findtext("name", "")
    maintainer = description.find("maintainer")
    # `ros2 run` looks for executables in lib/<package>.
    scripts = f"$base/lib/{name}"
    setup(
        name=name,
        version=description.findtext("version"),
        description=description.findtext("description"),
        maintainer=maintainer.text if maintainer is not None else "",
        maintainer_email=maintainer.get("email") if maintainer is not None else "",
        license=description.findtext("license"),
        packages=find_packages(exclude=["test"]),
        package_data={
            name: ["py.typed", "**/LICENSE", *(f"**/*.{end}" for end in ("json", "html", "j2", "c", "js", "css"))]
        },
        data_files=[("share/ament_index/resource_index/packages", [f"resource/{name}"]), (f"share/{name}", ["package.xml"])],
        install_requires=["setuptools"],
        extras_require={"test": ["pytest"]},  # without it, `colcon test` runs no test and reports success
        zip_safe=True,
        entry_points={"console_scripts": [f"{command} = {module}:main" for command, module in executables(name)]},
        options={"develop": {"script_dir": scripts}, "install": {"install_scripts": scripts}},
    )


def executables(package: str) -> Iterator[tuple[str, str]]:
    """Yield each executable of a package and its module, a file in nodes/ or cli/ that defines `main`.

    The file of an executable whose name is a word of Python, such as ``import``, ends with an underscore.
    """
    for folder in ("nodes", "cli"):
        for file in sorted(Path(package, folder).glob("*.py")):
            if re.search(r"^def main\(", file.read_text(encoding="utf-8"), re.MULTILINE):
                yield file.stem.rstrip("_"), f"{package}.{folder}.{file.stem}"
