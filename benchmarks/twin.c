/* What the compiled kernels are held against: the same system calls and the same work, in C.
 *
 *   twin loop FD PERIOD_NS WINDOW_NS SECONDS PRIORITY CPU     the data plane's cycle on a bus (host/realtime/loop.py)
 *   twin probe TX RX BURSTS PERIOD_NS PRIORITY CPU FRAME_NS FRAMES GAP_NS EVERY EXTRA_NS   frames sent, and when a bus delivers them
 *   twin serve CPU FD...                                      a bus without time: the fan-out of sim_bus/server/realtime_loop.py
 *   twin crowd ROUNDS MESSAGE_FRAMES CPU FD...                clients that all send, and read what the others sent
 *
 * Descriptors are connected AF_UNIX SOCK_SEQPACKET sockets (or AF_CAN for the loop) that the parent has greeted. The result is one line of
 * JSON on the standard output; histograms are pairs of microseconds and count.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { BINS = 20000, RING = 1 << 16, MESSAGE = 64, MAX_CLIENTS = 32, CROWD_MESSAGE = 1024 };
#define SECOND 1000000000LL

typedef struct { uint32_t id; uint8_t length, pad[3]; uint64_t word; } frame_t;
typedef struct { int64_t t, id, length, word, source; } row_t;

static row_t ring[RING];
static uint64_t head;
static int64_t wakeup[BINS], latency[BINS], destroyed[BINS];

static int64_t clock_of(clockid_t which)
{
    struct timespec t;
    clock_gettime(which, &t);
    return t.tv_sec * SECOND + t.tv_nsec;
}

static int64_t now(void) { return clock_of(CLOCK_MONOTONIC); }

static void count(int64_t *bins, int64_t ns)
{
    int64_t us = ns < 0 ? 0 : ns / 1000;
    bins[us < BINS ? us : BINS - 1]++;
}

static void histogram(const char *name, const int64_t *bins)
{
    const char *comma = "";
    printf(", \"%s\": [", name);
    for (int i = 0; i < BINS; i++)
        if (bins[i]) {
            printf("%s[%d, %ld]", comma, i, (long)bins[i]);
            comma = ", ";
        }
    printf("]");
}

/* As coulombus/system/realtime.py: nothing is required. */
static void real_time(int priority, int cpu)
{
    static const int32_t zero = 0;
    cpu_set_t set;
    struct sched_param parameter = {.sched_priority = priority};
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    prctl(PR_SET_TIMERSLACK, 1);
    CPU_ZERO(&set);
    CPU_SET(cpu, &set);
    sched_setaffinity(0, sizeof set, &set);
    mlockall(MCL_CURRENT | MCL_FUTURE);
    memset(ring, 0, sizeof ring);
    if (priority > 0) {
        int fd = open("/dev/cpu_dma_latency", O_WRONLY | O_CLOEXEC); /* held open to the end */
        if (fd >= 0 && write(fd, &zero, sizeof zero) < 0)
            close(fd);
        sched_setscheduler(0, SCHED_FIFO, &parameter);
    }
}

/* One message with the kernel's stamp; as coulombus/wire/recvmsg.py. */
static ssize_t receive(int fd, frame_t *into, size_t bytes, int flags, int64_t *stamp)
{
    char room[128];
    struct iovec part = {into, bytes};
    struct msghdr message = {.msg_iov = &part, .msg_iovlen = 1, .msg_control = room, .msg_controllen = sizeof room};
    ssize_t n = recvmsg(fd, &message, flags);
    *stamp = 0;
    if (n > 0)
        for (struct cmsghdr *c = CMSG_FIRSTHDR(&message); c; c = CMSG_NXTHDR(&message, c))
            if (c->cmsg_level == SOL_SOCKET && c->cmsg_type == SCM_TIMESTAMPNS) {
                struct timespec t;
                memcpy(&t, CMSG_DATA(c), sizeof t);
                *stamp = t.tv_sec * SECOND + t.tv_nsec;
            }
    return n;
}

static void log_frame(int64_t t, uint32_t id, int length, uint64_t word, int source)
{
    row_t *r = &ring[head & (RING - 1)];
    r->t = t, r->id = id, r->length = length, r->word = (int64_t)word, r->source = source;
    __atomic_store_n(&head, head + 1, __ATOMIC_RELEASE);
}

/* ---- the cycle ---- */

static struct {
    int arrived, statusword, position, velocity, handle, coil, degrees, torque, stuck, overrun;
    double x_stuck, psi, brake;
    int64_t frames, full, lost;
} host;

/* Karnopp's law with the brake as its actuator (host/laws/laws.py), then its limits. */
static void law(void)
{
    const double counts_rad = 8192 * 9.587 / (2 * M_PI), K_p = 10000, F_s = 3.5, F_d = 3.0;
    double x = host.position / counts_rad;
    if (abs(host.velocity) > 2000) {
        host.stuck = 0;
        host.brake = F_d;
        host.psi = host.velocity > 0 ? F_d : -F_d;
    } else {
        if (!host.stuck) {
            host.stuck = 1;
            host.x_stuck = x - host.psi / K_p;
        }
        double force = K_p * (x - host.x_stuck);
        if (fabs(force) > F_s) {
            force = force > 0 ? F_s : -F_s;
            host.x_stuck = x - force / K_p;
        }
        host.brake = F_s;
        host.psi = force;
    }
    host.brake = fmin(fmax(host.brake, 0), 4.5);
}

enum { EMPTY, TOOK, COMPLETE, GONE };

static int take(int fd)
{
    frame_t in[MESSAGE];
    int64_t stamp, t;
    int found = TOOK;
    ssize_t n = receive(fd, in, sizeof in, MSG_DONTWAIT, &stamp);
    if (n <= 0)
        return n < 0 && errno == EAGAIN ? EMPTY : n < 0 && errno == EINTR ? TOOK : GONE;
    t = now();
    if (stamp) {
        int64_t age = clock_of(CLOCK_REALTIME) - stamp;
        if (age > 0 && age < SECOND)
            t -= age;
    }
    for (size_t i = 0; i < n / sizeof *in; i++) {
        uint64_t w = in[i].word;
        host.frames++;
        log_frame(t, in[i].id, in[i].length, w, 0);
        switch (in[i].id) {
        case 0x181:
            host.velocity = 1000 * ((int32_t)(w >> 16) - host.position);
            host.statusword = w & 0xFFFF, host.position = (int32_t)(w >> 16), host.torque = (int16_t)(w >> 48);
            host.arrived |= 1;
            break;
        case 0x182:
            host.handle = (int16_t)w, host.coil = (int16_t)(w >> 16), host.degrees = (int16_t)(w >> 32);
            host.arrived |= 2;
            break;
        default:
            continue;
        }
        if (host.arrived == 3)
            found = COMPLETE;
    }
    return found;
}

static void transmit(int fd, const frame_t *out, int frames)
{
    while (send(fd, out, frames * sizeof *out, MSG_DONTWAIT | MSG_NOSIGNAL) < 0)
        if (errno != EINTR) {
            host.full += frames;
            return;
        }
    int64_t t = now();
    for (int i = 0; i < frames; i++)
        log_frame(t, out[i].id, out[i].length, out[i].word, -1);
}

static int controlword(int statusword)
{
    switch (statusword & 0x6F) {
    case 0x21: return 0x07;
    case 0x23: case 0x27: return 0x0F;
    case 0x08: return 0x80;
    default: return 0x06;
    }
}

static int loop(char **a)
{
    int fd = atoi(a[0]), cycles = 0;
    int64_t period = atoll(a[1]), window = atoll(a[2]), missed = 0, heartbeat = 0, lates = 0;
    struct pollfd wait = {.fd = fd, .events = POLLIN};
    real_time(atoi(a[4]), atoi(a[5]));
    int64_t t = (now() + 20000000) / period * period, end = t + (int64_t)(atof(a[3]) * SECOND);
    int64_t cpu = clock_of(CLOCK_THREAD_CPUTIME_ID);
    while (t < end) {
        struct timespec at = {t / SECOND, t % SECOND};
        if (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL))
            continue;
        int64_t wake = now(), late = (wake - t) / period;
        count(wakeup, wake - t);
        int was_late = late > 0;
        if (late > 0)
            t += late * period, missed += late;
        int found = TOOK;
        while (found != EMPTY)
            if ((found = take(fd)) == GONE)
                return 1;
        if (cycles && host.arrived != 3)
            host.lost++;
        host.arrived = 0;
        frame_t out[2] = {{.id = 0x80}, {.id = 0x77F, .length = 1, .word = 5}};
        int beat = t >= heartbeat;
        if (beat)
            heartbeat = t + 50000000;
        transmit(fd, out, 1 + beat);
        int64_t sync = now(), limit = sync + window, left;
        while ((left = limit - now()) > 0) {
            struct timespec rest = {left / SECOND, left % SECOND};
            if (ppoll(&wait, 1, &rest, NULL) <= 0)
                continue;
            if ((found = take(fd)) == COMPLETE)
                break;
            if (found == GONE)
                return 1;
        }
        law();
        frame_t rpdo[2] = {{.id = 0x201, .length = 4, .word = controlword(host.statusword)},
                           {.id = 0x202, .length = 2, .word = (uint64_t)lround(host.brake * 1000)}};
        transmit(fd, rpdo, 2);
        int64_t done = now();
        count(latency, done - sync);
        t += period;
        late = (done - t + period - 1) / period;
        if (late > 0)
            t += late * period, missed += late, was_late = 1;
        lates += was_late;
        cycles++;
    }
    cpu = clock_of(CLOCK_THREAD_CPUTIME_ID) - cpu;
    frame_t safe[3] = {{.id = 0x201, .length = 4}, {.id = 0x202, .length = 2}, {.id = 0x80}};
    transmit(fd, safe, 3);
    printf("{\"cycles\": %d, \"missed\": %ld, \"late\": %ld, \"cpu_us\": %.3f, \"incomplete\": %ld, \"full\": %ld", cycles, (long)missed, (long)lates,
           cpu / 1e3 / cycles, (long)host.lost, (long)host.full);
    histogram("wakeup", wakeup);
    histogram("latency", latency);
    puts("}");
    return 0;
}

/* ---- when a bus delivers ----
 * A burst of FRAMES equal frames is sent at `before` at the earliest; the k-th of them ends FRAME_NS * k after that, less the inter-frame
 * space that the parent takes off. The kernel's stamp on what the receiver gets is when the bus handed it out. A burst that
 * met a frame of somebody else is left out. With EVERY > 0 the bus destroys each EVERYth of all these frames once, which takes EXTRA_NS. */
static int probe(char **a)
{
    int tx = atoi(a[0]), rx = atoi(a[1]), bursts = atoi(a[2]), frames = atoi(a[7]), used = 0;
    int64_t period = atoll(a[3]), frame_ns = atoll(a[6]), gap_ns = atoll(a[8]), every = atoll(a[9]), extra_ns = atoll(a[10]), stamp, sent = 0;
    frame_t out[MESSAGE], in[MESSAGE];
    struct pollfd wait = {.fd = rx, .events = POLLIN};
    real_time(atoi(a[4]), atoi(a[5]));
    for (int i = 0; i < frames; i++)
        out[i] = (frame_t){.id = 0x555, .length = 8, .word = 0x5555555555555555ULL};
    int64_t t = now() + 20000000;
    for (int burst = 0; burst < bursts; burst++, t += period) {
        struct timespec at = {t / SECOND, t % SECOND};
        int64_t late[MESSAGE], extra = 0;
        int got = 0, alone = 1, hit[MESSAGE];
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL))
            ;
        while (receive(rx, in, sizeof in, MSG_DONTWAIT, &stamp) > 0)
            ;
        int64_t before = clock_of(CLOCK_REALTIME);
        if (send(tx, out, frames * sizeof *out, MSG_NOSIGNAL) < 0)
            return 1;
        while (got < frames) {
            if (poll(&wait, 1, 1000) <= 0)
                return 1;
            ssize_t n = receive(rx, in, sizeof in, MSG_DONTWAIT, &stamp);
            if (n == 0)
                return 1;
            for (ssize_t i = 0; i < n / (ssize_t)sizeof *in; i++)
                if (in[i].id == 0x555 && got < frames) {
                    hit[got] = every > 0 && ++sent % every == 0;
                    extra += hit[got] * extra_ns;
                    late[got] = stamp - before - (got + 1) * frame_ns + gap_ns - extra;
                    got++;
                } else
                    alone = 0;
        }
        if (alone) {
            used++;
            for (int i = 0; i < frames; i++) {
                count(latency, late[i]);
                if (hit[i])
                    count(destroyed, late[i]);
            }
        }
        while (t + period < now()) /* after a standstill of the machine */
            t += period;
    }
    printf("{\"bursts\": %d, \"used\": %d", bursts, used);
    histogram("delivery", latency);
    histogram("destroyed", destroyed);
    puts("}");
    return 0;
}

/* ---- fan-out without time ---- */

static frame_t batch[MAX_CLIENTS][MESSAGE];
static int waiting[MAX_CLIENTS];
static int64_t lost;

static void flush(int fd, int i)
{
    if (waiting[i] && send(fd, batch[i], waiting[i] * sizeof(frame_t), MSG_DONTWAIT | MSG_NOSIGNAL) < 0)
        lost += waiting[i];
    waiting[i] = 0;
}

static int serve(int n, char **a)
{
    static frame_t in[CROWD_MESSAGE];
    struct pollfd polls[MAX_CLIENTS];
    int64_t frames = 0, stamp;
    int open_clients = n - 1;
    real_time(0, atoi(a[0]));
    for (int i = 0; i < n - 1; i++)
        polls[i] = (struct pollfd){.fd = atoi(a[1 + i]), .events = POLLIN};
    n--;
    int64_t cpu = clock_of(CLOCK_THREAD_CPUTIME_ID);
    while (open_clients > 0) {
        ppoll(polls, n, NULL, NULL);
        for (int i = 0; i < n; i++) {
            ssize_t got;
            if (!polls[i].revents)
                continue;
            while ((got = receive(polls[i].fd, in, sizeof in, MSG_DONTWAIT, &stamp)) > 0)
                for (size_t k = 0; k < got / sizeof *in; k++, frames++)
                    for (int j = 0; j < n; j++)
                        if (j != i) {
                            batch[j][waiting[j]++] = in[k];
                            if (waiting[j] == MESSAGE)
                                flush(polls[j].fd, j);
                        }
            if (got == 0) {
                polls[i].fd = -1;
                open_clients--;
            }
        }
        for (int i = 0; i < n; i++)
            flush(polls[i].fd, i);
    }
    printf("{\"frames\": %ld, \"lost\": %ld, \"cpu_s\": %.6f}\n", (long)frames, (long)lost,
           (clock_of(CLOCK_THREAD_CPUTIME_ID) - cpu) * 1e-9);
    return 0;
}

static int crowd(int n, char **a)
{
    static frame_t out[CROWD_MESSAGE], in[CROWD_MESSAGE];
    int rounds = atoi(a[0]), frames = atoi(a[1]);
    n -= 3;
    a += 3;
    real_time(0, atoi(a[-1]));
    for (int i = 0; i < n; i++)
        fcntl(atoi(a[i]), F_SETFL, fcntl(atoi(a[i]), F_GETFL) & ~O_NONBLOCK);
    int64_t begin = now();
    for (int round = 0; round < rounds; round++) {
        for (int i = 0; i < n; i++) {
            for (int k = 0; k < frames; k++)
                out[k] = (frame_t){.id = 0x400 + i, .length = 8, .word = (uint64_t)round << 32 | k};
            if (send(atoi(a[i]), out, frames * sizeof *out, MSG_NOSIGNAL) < 0)
                return 1;
        }
        for (int i = 0; i < n; i++)
            for (ssize_t left = (n - 1) * frames; left > 0;) {
                ssize_t got = recv(atoi(a[i]), in, sizeof in, 0);
                if (got <= 0)
                    return 1;
                left -= got / (ssize_t)sizeof *in;
            }
    }
    int64_t ns = now() - begin;
    printf("{\"frames\": %ld, \"seconds\": %.6f}\n", (long)rounds * n * frames, ns * 1e-9);
    return 0;
}

int main(int argc, char **argv)
{
    const char *what = argc > 1 ? argv[1] : "";
    if (!strcmp(what, "loop") && argc == 8)
        return loop(argv + 2);
    if (!strcmp(what, "probe") && argc == 13)
        return probe(argv + 2);
    if (!strcmp(what, "serve") && argc > 4)
        return serve(argc - 2, argv + 2);
    if (!strcmp(what, "crowd") && argc > 6)
        return crowd(argc - 2, argv + 2);
    fprintf(stderr, "twin: see benchmarks/realtime.py\n");
    return 2;
}
