"""The cases, by subject: a module for each service or kind of PDO; its docstring names its cases."""
