"""Columns among named arrays of any shape, as MATLAB and HDF5 files hold them."""

from collections.abc import Iterator, Mapping

_MOST_COLUMNS = 64  # of a matrix; a larger one is an image or a parameter field
FEWEST_ROWS = 3


def columns_of(name: str, shape: tuple[int, ...]) -> Iterator[tuple[str, tuple[int | slice, ...]]]:
    """Yield name and index of each column of an array: all of a vector, or each short side of a matrix.

    Parameters
    ----------
    name : str
    shape : tuple of int
        A matrix has its samples along the longer side.
    """
    sides = [axis for axis, length in enumerate(shape) if length > 1]
    if len(sides) == 1 and shape[sides[0]] >= FEWEST_ROWS:
        yield name, tuple(slice(None) if axis == sides[0] else 0 for axis in range(len(shape)))
    elif len(sides) == 2 and min(shape[axis] for axis in sides) <= _MOST_COLUMNS:
        long, short = sorted(sides, key=lambda axis: -shape[axis])
        for number in range(shape[short]):
            index: dict[int, int | slice] = {long: slice(None), short: number}
            yield f"{name}({number + 1})", tuple(index.get(axis, 0) for axis in range(len(shape)))


def flatten(content: object, name: str = "") -> Iterator[tuple[str, object]]:
    """Yield the leaves of nested mappings with their dotted names."""
    if isinstance(content, Mapping):
        for key, value in content.items():
            yield from flatten(value, f"{name}.{key}" if name else str(key))
    else:
        yield name, content
