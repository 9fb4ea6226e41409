"""Foundation of the compiled functions: the decorator, its cache, and system calls for kernels."""
