"""Rig files as package data."""
