"""Gaussian-process regression of terrain: kernel and fast exact inference.

From a point to its part of the map:

- A **point** of a cloud has a position and the noise of its height. Where points are far denser
  than the kernel is wide, `cloud.thin_dense` replaces those of a small cell by their mean.
- A **Cloud** (`cloud`) holds the points in an order in which neighbours are together. `inference`
  estimates what the two exact solvers would cost, and takes the faster one: tiles for sparse
  points, the lattice for dense ones.
- A **Splat** (`splat`) is the matrix of Gaussians between the points and the nodes of a regular
  lattice, kept as its two factors. `FineKernel` makes the kernel of it, so that a product with the
  kernel costs a splat there and back.
- A **Tile** (`tiles`) is a square of five length-scales. The covariance of its points and of those
  around it is inverted directly; that gives its variance, and corrects the mean sweep by sweep.
- A **Strip** (`lattice`) is a range of x. Its weight space (`weight_space`) is a banded matrix over
  lattice nodes, whose factor gives the variance over the strip.
- A **Panel** (`lattice`) is the strips that are solved together: the mean over its range of x, with
  the strips as the preconditioner.
- A **Patch** (`likelihood`) has nothing to do with the map: it is a disc of a few hundred points
  whose heights have one joint likelihood. Hyperparameters are fitted to many of them.
"""
