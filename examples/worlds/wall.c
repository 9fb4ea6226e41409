/* A wall at 0 rad, from C: compile it with `cc -std=gnu11 -o wall examples/worlds/wall.c`, and run it
 * beside `coulombus run --world`. `wall BUS STATES` ends after so many states. */
#include "coulombus_world.h"

int main(int count, char **words) {
    const char *bus = count > 1 ? words[1] : "bench";
    long states = count > 2 ? atol(words[2]) : 5000;
    struct coulombus_world world;
    struct coulombus_model model = coulombus_model(0.1);
    union coulombus_record record;
    if (coulombus_connect(&world, bus, "") != 0) {
        perror(bus);
        return 1;
    }
    model.parts = COULOMBUS_WALL;
    model.law = 0.0;
    model.wall_K_Nm_rad = 2.0;
    model.wall_B_Nms_rad = 0.05;
    while (states > 0 && coulombus_next(&world, &record) == 0) {
        if (record.head.kind == COULOMBUS_REFUSED && !record.refused.again) {
            fprintf(stderr, "refused: %.232s\n", record.refused.reason);
            return 1;
        }
        if (record.head.kind != COULOMBUS_STATE) continue;
        states--;
        if (record.state.sequence % 10 == 0 && coulombus_render(&world, &model) != 0) break;
        if (record.state.sequence % 500 == 0)
            printf("%.3f rad, wall %.3f Nm\n", record.state.x_rad, record.state.world_Nm);
    }
    close(world.fd);
    return 0;
}
