"""Facts about the manifolds and their bundles."""
