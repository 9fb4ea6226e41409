/* The socket of a display for a world outside, in C11 and C++: docs/worlds.md has the protocol.
 *
 * Include it in one file or in many; all functions are static. Little-endian machines, Linux.
 * A function that returns int returns 0, or -1 with errno set; EPROTO: not the host's protocol.
 *
 *     struct coulombus_world world;
 *     if (coulombus_connect(&world, "bench", "") != 0) { perror("bench"); return 1; }
 *     struct coulombus_model model = coulombus_model(0.1);
 *     model.parts = COULOMBUS_WALL;
 *     model.wall_K_Nm_rad = 2.0;
 *     coulombus_render(&world, &model);
 */
#ifndef COULOMBUS_WORLD_H
#define COULOMBUS_WORLD_H

#include <errno.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

enum { COULOMBUS_HELLO = 1, COULOMBUS_MODEL, COULOMBUS_WELCOME, COULOMBUS_PARAMETER, COULOMBUS_STATE, COULOMBUS_REFUSED };
enum { COULOMBUS_WALL = 1, COULOMBUS_SPRING = 2, COULOMBUS_FIELD = 4, COULOMBUS_PROFILE = 8, COULOMBUS_PARAMETERS = 16,
       COULOMBUS_PLANE = 32 /* the parts are those of the plane */ };
enum { COULOMBUS_RUN = 5 }; /* coulombus_state.phase while the display runs */

struct coulombus_head {
    uint16_t kind, size;
    uint32_t zero;
};

struct coulombus_hello {
    struct coulombus_head head;
    char magic[8]; /* COULWRLD */
    int64_t version; /* 2 */
    int64_t flags; /* 1: send states */
    char key[32]; /* arm key of a real rig, ASCII, zero bytes behind it */
};

struct coulombus_model { /* SI at the handle; field and samples: torque on the handle */
    struct coulombus_head head;
    int64_t sequence, t_ns, life_ns, axis, parts;
    double law; /* share of the rig's law, 0 to 1 */
    double wall_x_rad;
    int64_t wall_side; /* 1: the wall is above wall_x_rad, -1: below */
    double wall_K_Nm_rad, wall_B_Nms_rad;
    double spring_x_rad, spring_K_Nm_rad, spring_B_Nms_rad, spring_most_Nm;
    double field_Nm, field_Nm_rad, field_Nms_rad;
    /* in the plane, of an arm's tip: m and N */
    double plane_wall_point_m[2], plane_wall_normal[2]; /* the normal points out of the wall, and has length 1 */
    double plane_wall_K_N_m, plane_wall_B_Ns_m;
    double plane_spring_point_m[2], plane_spring_K_N_m, plane_spring_B_Ns_m, plane_spring_most_N;
    double plane_field_N[2], plane_field_N_m[4], plane_field_Ns_m[4]; /* matrices by rows */
    double profile_direction[2]; /* length 1 */
    int64_t profile, samples, sample_ns;
    int64_t parameters; /* bits of the slots that are set */
    double parameter[20]; /* by slot, as the PARAMETER records tell */
    float sample[64];
};

struct coulombus_welcome {
    struct coulombus_head head;
    int64_t version, axes, parameters, period_ns, mode, longest_life_ns, now_ns;
};

struct coulombus_parameter {
    struct coulombus_head head;
    int64_t axis, slot; /* slot -1: a limit, not to be set */
    double low, high, value;
    char name[40];
};

struct coulombus_state {
    struct coulombus_head head;
    int64_t sequence, t_ns, axis, phase, trip;
    double x_rad, v_rad_s, handle_Nm, motor_Nm, brake_Nm, law_Nm, world_Nm, world_brake_Nm;
    double tip_x_m, tip_y_m, tip_vx_m_s, tip_vy_m_s, hand_x_N, hand_y_N, world_x_N, world_y_N; /* of an arm */
    double share;
    int64_t model, clipped;
    double softened;
    int64_t lost, sent_ns;
};

struct coulombus_refused {
    struct coulombus_head head;
    int64_t sequence, again;
    char reason[232];
};

union coulombus_record {
    struct coulombus_head head;
    struct coulombus_welcome welcome;
    struct coulombus_parameter parameter;
    struct coulombus_state state;
    struct coulombus_refused refused;
};

#ifdef __cplusplus
#define COULOMBUS_SIZE(type, size) static_assert(sizeof(struct type) == size, #type)
#else
#define COULOMBUS_SIZE(type, size) _Static_assert(sizeof(struct type) == size, #type)
#endif
COULOMBUS_SIZE(coulombus_hello, 64);
COULOMBUS_SIZE(coulombus_model, 776);
COULOMBUS_SIZE(coulombus_welcome, 64);
COULOMBUS_SIZE(coulombus_parameter, 88);
COULOMBUS_SIZE(coulombus_state, 224);
COULOMBUS_SIZE(coulombus_refused, 256);

struct coulombus_world {
    int fd;
    int64_t sequence; /* of the last model */
};

static inline int64_t coulombus_now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

/* Write the path of the socket of the host on the virtual bus `bus` ("socketcan-can0" for can0). */
static inline void coulombus_path(const char *bus, char *path, size_t size) {
    const char *runtime = getenv("XDG_RUNTIME_DIR"), *temporary = getenv("TMPDIR");
    struct stat found;
    if (runtime != NULL && runtime[0] == '/' && stat(runtime, &found) == 0 && found.st_uid == geteuid())
        snprintf(path, size, "%s/coulombus/%s.world", runtime, bus);
    else
        snprintf(path, size, "%s/coulombus-%ld/%s.world", temporary != NULL ? temporary : "/tmp", (long)geteuid(), bus);
}

static inline int coulombus_put(int fd, const void *record, size_t size) {
    const char *data = (const char *)record;
    while (size > 0) {
        ssize_t sent = send(fd, data, size, MSG_NOSIGNAL);
        if (sent < 0) {
            if (errno == EINTR) continue;
            return -1;
        }
        data += sent;
        size -= (size_t)sent;
    }
    return 0;
}

/* Wait for `size` bytes. */
static inline int coulombus_get(int fd, void *record, size_t size) {
    char *data = (char *)record;
    while (size > 0) {
        ssize_t got = recv(fd, data, size, 0);
        if (got < 0 && errno == EINTR) continue;
        if (got <= 0) {
            if (got == 0) errno = ECONNRESET;
            return -1;
        }
        data += got;
        size -= (size_t)got;
    }
    return 0;
}

/* Wait for the next record: look at record->head.kind. The first ones are WELCOME and its PARAMETERs. */
static inline int coulombus_next(struct coulombus_world *world, union coulombus_record *record) {
    if (coulombus_get(world->fd, &record->head, sizeof record->head) != 0) return -1;
    if (record->head.size < sizeof record->head || record->head.size > sizeof *record) {
        errno = EPROTO;
        return -1;
    }
    return coulombus_get(world->fd, (char *)record + sizeof record->head, record->head.size - sizeof record->head);
}

static inline int coulombus_connect(struct coulombus_world *world, const char *bus, const char *key) {
    struct sockaddr_un address;
    struct coulombus_hello hello;
    memset(&address, 0, sizeof address);
    memset(&hello, 0, sizeof hello);
    address.sun_family = AF_UNIX;
    coulombus_path(bus, address.sun_path, sizeof address.sun_path);
    hello.head.kind = COULOMBUS_HELLO;
    hello.head.size = sizeof hello;
    memcpy(hello.magic, "COULWRLD", 8);
    hello.version = 2;
    hello.flags = 1;
    memcpy(hello.key, key, strlen(key) < sizeof hello.key ? strlen(key) : sizeof hello.key);
    world->sequence = 0;
    world->fd = socket(AF_UNIX, SOCK_STREAM, 0);
    if (world->fd < 0) return -1;
    if (connect(world->fd, (struct sockaddr *)&address, sizeof address) == 0
        && coulombus_put(world->fd, &hello, sizeof hello) == 0)
        return 0;
    close(world->fd);
    return -1;
}

/* Return a model without parts, beside the whole law of the rig. */
static inline struct coulombus_model coulombus_model(double life_s) {
    struct coulombus_model model;
    memset(&model, 0, sizeof model);
    model.head.kind = COULOMBUS_MODEL;
    model.head.size = sizeof model;
    model.life_ns = (int64_t)(life_s * 1e9);
    model.law = 1.0;
    model.wall_side = 1;
    return model;
}

/* Send a model; its time to live begins now. */
static inline int coulombus_render(struct coulombus_world *world, struct coulombus_model *model) {
    model->sequence = ++world->sequence;
    model->t_ns = coulombus_now_ns();
    return coulombus_put(world->fd, model, sizeof *model);
}

#endif
