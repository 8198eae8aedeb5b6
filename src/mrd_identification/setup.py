from setuptools import find_packages, setup

package = "mrd_identification"

setup(
    name=package,
    version="0.1.0",
    description="Identification of damper models and their comparison",
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
            "identifier = mrd_identification.nodes.identifier:main",
            "identify = mrd_identification.cli.identify:main",
            "compare = mrd_identification.cli.compare:main",
            "export = mrd_identification.cli.export:main",
        ]
    },
)
