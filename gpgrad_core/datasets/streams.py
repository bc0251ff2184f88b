"""Independent random generators for everything that is simulated."""

from numpy.random import PCG64, Generator, SeedSequence


def stream(*path: int) -> Generator:
    """Make an independent random generator, so that one more submap does not change the others.

    Args:
        path: Numbers that identify it; the first is the seed of the simulation.
    """
    return Generator(PCG64(SeedSequence(path)))


def stream_at(seed: int, number: int, i: int, j: int) -> Generator:
    """Make the random generator of a square of a lattice.

    Args:
        seed: The seed of the simulation.
        number: What is drawn there.
        i: Column of the square; may be negative.
        j: Row of the square; may be negative.
    """
    return stream(seed, number, *(2 * k if k >= 0 else -2 * k - 1 for k in (i, j)))
