"""A robot controller behind Modbus TCP: firmware, registers, telegrams."""
