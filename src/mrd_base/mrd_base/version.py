"""The version of the software: that of every package, and of the distribution that `pip install .` makes of them."""

VERSION = "0.1.0"
