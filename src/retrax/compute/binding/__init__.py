"""The compiled core as Python sees it: its library, structs, and classes that own the memory of each."""
