"""A small study file for tests."""

TEXT = """name = "jnd"
seconds = 0.05
seed = 3
reference = 2.0
question = "more?"
[level]
"mode.{mode}.F_s_Nm" = 1.0
"mode.{mode}.F_d_Nm" = 0.85
[method]
kind = "constant"
levels = [1.6, 2.4]
repeats = 2
[[condition]]
name = "a"
"""
