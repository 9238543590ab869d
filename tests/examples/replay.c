/* Plays calls from stdin to the joint's core, and writes what it answers to stdout: the core in a process of its own. */
#include <stdio.h>
#include <string.h>

#include "joint.h"

struct call {
    uint8_t kind, length, joints, unused;
    uint32_t id;
    int64_t now_ns;
    uint8_t data[8];
    int64_t tail_ns, compute_ns;
};

struct row {
    int32_t count, count_prev, w_prev, d, a_ref, table[JOINT_PARAMETERS];
};

static void step_rows(void)
{
    struct joint_law law = {0};
    struct row row;

    while (fread(&row, sizeof row, 1, stdin) == 1) {
        int16_t i, estimate;

        law.count_prev = (uint16_t)row.count_prev;
        law.w_prev = (int16_t)row.w_prev;
        law.d = row.d;
        for (int n = 0; n < JOINT_PARAMETERS; n++)
            law.table[n] = (int16_t)row.table[n];
        joint_step(&law, (uint16_t)row.count, (int16_t)row.a_ref, &i, &estimate);
        fwrite((int32_t[]){law.w_prev, law.d, i, estimate}, sizeof(int32_t), 4, stdout);
    }
    fwrite(law.saturations, sizeof law.saturations, 1, stdout);
}

static void play_calls(void)
{
    struct joint joint;
    struct joint_out out;
    struct call call;

    while (fread(&call, sizeof call, 1, stdin) == 1) {
        if (call.kind == 'i')
            joint_init(&joint, (uint8_t)call.id, call.joints, call.now_ns, call.tail_ns, call.compute_ns);
        else if (call.kind == 's')
            joint_store(&joint, call.id, call.data, call.length);
        else if (call.kind == 'f')
            joint_frame(&joint, call.id, call.data, call.length, call.now_ns, &out);
        else if (call.kind == 't')
            joint_timer(&joint, &out);
        if (call.kind == 'f' || call.kind == 't')
            fwrite(&out, sizeof out, 1, stdout);
        else if (call.kind == 'r')
            fwrite(&joint, sizeof joint, 1, stdout);
    }
}

int main(int argc, char **argv)
{
    if (argc > 1 && strcmp(argv[1], "rows") == 0)
        step_rows();
    else
        play_calls();
    return 0;
}
