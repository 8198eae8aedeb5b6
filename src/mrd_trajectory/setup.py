from setuptools import find_packages, setup

package = "mrd_trajectory"

setup(
    name=package,
    version="0.1.0",
    description="What the rod and the coil should do: waveforms, transitions, experiments, limits",
    maintainer="The bench's maintainers",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test"]),
    package_data={package: ["py.typed", "**/*.json", "**/*.html", "**/*.j2"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package]),
        ("share/" + package, ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    entry_points={
        "console_scripts": ["generator = mrd_trajectory.nodes.generator:main", "preview = mrd_trajectory.cli.preview:main"]
    },
)
