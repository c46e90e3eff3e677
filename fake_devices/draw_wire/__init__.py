"""A draw-wire gauge: the wire, its CANopen node, and the CAN daemon."""
