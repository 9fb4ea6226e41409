"""What the compiled functions rest on: the decorator and its cache, system calls for kernels."""
