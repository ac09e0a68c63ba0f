"""Identification: payload, friction, rotors and links from recorded runs, and the motions that excite them."""
