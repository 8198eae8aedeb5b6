from setuptools import find_packages, setup

package = "mrd_bench_driver"

setup(
    name=package,
    version="0.1.0",
    description="The machine: servo, DAQ, coil supply, interlocks, modes",
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
    extras_require={"test": ["pytest"], "ni": ["nidaqmx"]},
    zip_safe=True,
    entry_points={
        "console_scripts": [
            "servo = mrd_bench_driver.nodes.servo:main",
            "daq = mrd_bench_driver.nodes.daq:main",
            "supervisor = mrd_bench_driver.nodes.supervisor:main",
            "bench = mrd_bench_driver.nodes.bench:main",
            "sizing = mrd_bench_driver.cli.sizing:main",
        ]
    },
)
