"""Point the CMake files of the ROS wheels at this interpreter.

Some ``*.cmake`` files in the wheels name the folders of the machine that built them; CMake stops at a folder that is not
there. Run with the interpreter of the environment; running it again changes nothing.
"""

import re
import sys
import sysconfig
from pathlib import Path

import numpy

WHERE = {
    re.compile(r"/opt/python/cp3\d+-cp3\d+/include/python3\.\d+"): sysconfig.get_path("include"),
    re.compile(r"/opt/python/cp3\d+-cp3\d+/lib/python3\.\d+/site-packages/numpy/_core/include"): numpy.get_include(),
}

for file in Path(sys.prefix, "share").rglob("*.cmake"):
    text = repaired = file.read_text()
    for pattern, folder in WHERE.items():
        repaired = pattern.sub(folder, repaired)
    if repaired != text:
        file.write_text(repaired)
