"""The functions of a problem with a method, which the core takes: of steps, of nodes, and of linked ends."""
