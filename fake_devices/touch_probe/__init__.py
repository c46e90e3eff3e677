"""A touch probe and a dial gauge behind a Modbus TCP I/O coupler."""
