"""Linear algebra of trajectories over NumPy arrays, batch axis first: elimination, units, condensing."""
