"""The friction laws."""
