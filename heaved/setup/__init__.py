"""From a box to a service: what finds devices, measures how they are mounted, and writes the configuration."""
