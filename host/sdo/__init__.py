"""SDO client of the host, for bring-up and the services for devices."""
