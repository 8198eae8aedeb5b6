from setuptools import find_packages, setup

package = "mrd_sim"

setup(
    name=package,
    version="0.1.0",
    description="The simulator: damper models, effects, measuring chain, simulated motor and DAQ",
    maintainer="The bench's maintainers",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test"]),
    package_data={package: ["py.typed", "**/*.json", "**/*.html", "**/*.j2", "**/*.c"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package]),
        ("share/" + package, ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    entry_points={
        "console_scripts": [
            "plant = mrd_sim.nodes.plant:main",
            "simulate = mrd_sim.cli.simulate:main",
            "models = mrd_sim.cli.models:main",
            "effects = mrd_sim.cli.effects:main",
        ]
    },
)
