"""A working day: every procedure of the catalogue from its start to its certificate, in a browser, over sockets."""
