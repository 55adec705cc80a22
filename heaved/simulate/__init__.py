"""A simulated ship: seaways, vessel response, sensors (pure, seeded) and Modbus slaves that serve them."""
