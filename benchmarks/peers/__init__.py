"""Other programs that fit ellipses or find circles in space, each in an environment of its own."""
