"""The host as a service of the system: units of systemd and what belongs to them."""
