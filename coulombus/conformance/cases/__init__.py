"""Test cases by subject: a module per service or kind of PDO; its docstring names its cases."""
