"""What the tests share: the manifolds and retractions under test, draws, kernels in flat coordinates, slopes."""
