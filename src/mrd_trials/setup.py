from setuptools import find_packages, setup

package = "mrd_trials"

setup(
    name=package,
    version="0.1.0",
    description="Blind trials of the diagnosis: plants with withheld effects, sealed answers, scores",
    maintainer="The bench's maintainers",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test"]),
    package_data={package: ["py.typed", "**/*.j2"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package]),
        ("share/" + package, ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    entry_points={
        "console_scripts": [
            "make = mrd_trials.cli.make:main",
            "run = mrd_trials.cli.run:main",
            "score = mrd_trials.cli.score:main",
            "withhold = mrd_trials.cli.withhold:main",
        ]
    },
)
