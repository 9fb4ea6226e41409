/* Preloaded (LD_PRELOAD): the n-th call of one function of the C library fails, once, in the threads that ask for it.
   tests/support/libc_faults.py arms it; compiled loops reach the same symbols as Python does. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <poll.h>
#include <stddef.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { READ, WRITE, RECV, SEND, RECVMSG, PPOLL, NANOSLEEP, ACCEPT4, SETSOCKOPT, GETSOCKOPT, MMAP, MALLOC, CALLOC, REALLOC, FUNCTIONS };

static __thread int watched __attribute__((tls_model("initial-exec")));
static volatile int chosen = -1, number;
static volatile long at, calls[FUNCTIONS], failed;

void fault_watch(int on) { watched = on; }
long fault_calls(int function) { return calls[function]; }
long fault_failed(void) { return failed; }

void fault_arm(int function, long n, int error)
{
	chosen = -1;
	for (int i = 0; i < FUNCTIONS; i++)
		calls[i] = 0;
	failed = 0;
	at = n;
	number = error;
	chosen = function;
}

static int fails(int function)
{
	if (!watched)
		return 0;
	long call = __atomic_add_fetch(&calls[function], 1, __ATOMIC_SEQ_CST);
	if (function != chosen || call != at)
		return 0;
	failed = 1;
	errno = number;
	return 1;
}

#define SHIM(result, function, which, parameters, arguments)                  \
	result function parameters                                            \
	{                                                                     \
		static result(*real) parameters;                              \
		if (fails(which))                                             \
			return (result)-1;                                    \
		if (!real)                                                    \
			real = (result(*) parameters)dlsym(RTLD_NEXT, #function); \
		return real arguments;                                        \
	}

SHIM(ssize_t, read, READ, (int fd, void *b, size_t n), (fd, b, n))
SHIM(ssize_t, write, WRITE, (int fd, const void *b, size_t n), (fd, b, n))
SHIM(ssize_t, recv, RECV, (int fd, void *b, size_t n, int f), (fd, b, n, f))
SHIM(ssize_t, send, SEND, (int fd, const void *b, size_t n, int f), (fd, b, n, f))
SHIM(ssize_t, recvmsg, RECVMSG, (int fd, struct msghdr *m, int f), (fd, m, f))
SHIM(int, ppoll, PPOLL, (struct pollfd *p, nfds_t n, const struct timespec *t, const sigset_t *s), (p, n, t, s))
SHIM(int, accept4, ACCEPT4, (int fd, struct sockaddr *a, socklen_t *n, int f), (fd, a, n, f))
SHIM(int, setsockopt, SETSOCKOPT, (int fd, int l, int o, const void *v, socklen_t n), (fd, l, o, v, n))
SHIM(int, getsockopt, GETSOCKOPT, (int fd, int l, int o, void *v, socklen_t *n), (fd, l, o, v, n))
SHIM(void *, mmap, MMAP, (void *a, size_t n, int p, int f, int fd, off_t o), (a, n, p, f, fd, o))

int clock_nanosleep(clockid_t clock, int flags, const struct timespec *t, struct timespec *left)
{
	static int (*real)(clockid_t, int, const struct timespec *, struct timespec *);
	if (fails(NANOSLEEP))
		return number;
	if (!real)
		real = (int (*)(clockid_t, int, const struct timespec *, struct timespec *))dlsym(RTLD_NEXT, "clock_nanosleep");
	return real(clock, flags, t, left);
}

/* dlsym itself allocates: glibc's own names */
void *__libc_malloc(size_t);
void *__libc_calloc(size_t, size_t);
void *__libc_realloc(void *, size_t);
void *malloc(size_t n) { return fails(MALLOC) ? NULL : __libc_malloc(n); }
void *calloc(size_t k, size_t n) { return fails(CALLOC) ? NULL : __libc_calloc(k, n); }
void *realloc(void *p, size_t n) { return fails(REALLOC) ? NULL : __libc_realloc(p, n); }
