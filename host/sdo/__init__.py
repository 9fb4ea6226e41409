"""The SDO client of the host: bring-up and the services for devices use it alike."""
