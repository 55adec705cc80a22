"""How the bytes of an output leave, by kind of link. Nothing here ever waits for whoever reads."""
