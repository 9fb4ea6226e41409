"""The paper, equation by equation and figure by figure, and past it: each part computes a
dataclass, drawings come second.
"""
