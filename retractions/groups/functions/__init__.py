"""Functions of matrices between Lie algebras and their groups, with derivatives that are right everywhere."""
