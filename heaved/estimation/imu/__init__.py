"""From the readings of an IMU to the vertical acceleration: judged, levelled, at their own times."""
