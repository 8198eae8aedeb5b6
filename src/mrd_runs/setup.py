from setuptools import find_packages, setup

package = "mrd_runs"

setup(
    name=package,
    version="0.1.0",
    description="What a recording is: the Run, bags, recorder, replay, import",
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
        "console_scripts": [
            "recorder = mrd_runs.nodes.recorder:main",
            "replay = mrd_runs.nodes.replay:main",
            "import_csv = mrd_runs.cli.import_csv:main",
            "info = mrd_runs.cli.info:main",
        ]
    },
)
