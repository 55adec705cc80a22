"""Roll, pitch and yaw ahead."""
