from setuptools import find_packages, setup

package = "mrd_diagnosis"

setup(
    name=package,
    version="0.1.0",
    description="Diagnosis of the gap between simulator and recordings",
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
            "diagnoser = mrd_diagnosis.nodes.diagnoser:main",
            "diagnose = mrd_diagnosis.cli.diagnose:main",
            "apply = mrd_diagnosis.cli.apply:main",
            "trend = mrd_diagnosis.cli.trend:main",
        ]
    },
)
