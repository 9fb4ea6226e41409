"""A world outside: another program says what the hand meets, and the cycle renders it."""
