"""gpgrad_core: loop closures from Gaussian-process gradient maps of bare terrain."""
