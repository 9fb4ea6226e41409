"""The virtual bus in real time: clients, live nodes, the bridge."""
