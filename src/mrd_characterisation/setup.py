import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "setup"))
from ros_package import setup_ros_package

setup_ros_package()
