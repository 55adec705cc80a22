"""Everything that reads sensors: register profiles, Modbus polling, recordings as a source."""
