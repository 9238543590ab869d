/*
 * Joint N on a SocketCAN interface: joint_socketcan INTERFACE NUMBER [-j JOINTS] [-p PERIOD_US] [-w]
 *
 * One blocking read loop: Encoder k is answered when AccelRef k - 1 is there, State and Heartbeat behind Current. Time is
 * counted by the cycles of the Encoder frames, so a stopped bus is stopped time (`sync`); with -w Encoder waits for
 * nothing, and its silence is a fault by the machine's clock (`wall`). Ends as the Python node does: at Stop or in a fault.
 *
 * Ref: Documentation/networking/can.rst of the Linux kernel.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "arm.h"
#include "joint.h"

enum { USAGE = 2, CHANNEL = 4, STOPPED = 6 }; /* exit codes, as those of hil */
enum { JOINTS = 6, JOINTS_A_FRAME = 3, RETRIES = 1000 };

struct bus {
    int fd;
    uint32_t encoder, accel_ref, parameter;
    unsigned long waits; /* the transmit queue was full */
};

/* Sockets of one bus may hear its frames in different orders, so AccelRef k may come before Encoder k. */
struct board {
    struct joint joint;
    struct bus bus;
    bool by_the_wall;

    int64_t cycle;       /* Encoder counts modulo 256, from -256 at the earliest */
    uint8_t cycle_byte;
    bool announced;      /* AccelRef has come; the first is that of cycle -1 */
    struct can_frame references[2];     /* AccelRef of even cycles, of odd ones */
    struct can_frame encoder, answered; /* the newest, and the last that was answered with `out` */
    bool waiting;        /* Encoder k waits for AccelRef k - 1 */
    struct joint_out out;
};

static void fail(const char *interface, const char *cure)
{
    fprintf(stderr, "joint: %s: %s; %s\n", interface, strerror(errno), cure);
    exit(CHANNEL);
}

static void join(struct bus *bus, const char *interface, uint32_t number)
{
    struct sockaddr_can address = {.can_family = AF_CAN};
    const uint32_t exactly = CAN_SFF_MASK | CAN_EFF_FLAG | CAN_RTR_FLAG;

    bus->encoder = ARM_ENCODER_1_FRAME_ID + number - 1;
    bus->parameter = ARM_PARAMETER_1_FRAME_ID + number - 1;
    bus->accel_ref = ARM_ACCEL_REF_FRAME_ID + (number - 1) / JOINTS_A_FRAME;
    const struct can_filter filters[] = {{ARM_STOP_FRAME_ID, exactly}, {bus->encoder, exactly},
                                         {bus->accel_ref, exactly}, {bus->parameter, exactly}};
    bus->fd = socket(AF_CAN, SOCK_RAW, CAN_RAW);
    if (bus->fd < 0)
        fail(interface, "this kernel needs its modules can and can-raw");
    address.can_ifindex = (int)if_nametoindex(interface);
    if (address.can_ifindex == 0)
        fail(interface, "`ip -br link` lists the interfaces");
    if (setsockopt(bus->fd, SOL_CAN_RAW, CAN_RAW_FILTER, filters, sizeof filters) < 0 ||
        bind(bus->fd, (struct sockaddr *)&address, sizeof address) < 0)
        fail(interface, "is it a CAN interface?");
}

/* A full transmit queue is waited for, up to a second; nothing is lost in silence. */
static void send_all(struct bus *bus, const struct joint_out *out)
{
    for (int n = 0; n < out->sends; n++) {
        struct can_frame frame = {.can_id = out->send[n].id, .can_dlc = out->send[n].length};
        int tries = RETRIES;

        memcpy(frame.data, out->send[n].data, sizeof frame.data);
        while (write(bus->fd, &frame, sizeof frame) != sizeof frame) {
            if ((errno != ENOBUFS && errno != EAGAIN && errno != EINTR) || tries-- == 0)
                fail("write", "is the interface up, and does anybody acknowledge?");
            bus->waits++;
            nanosleep(&(struct timespec){.tv_nsec = 1000000}, NULL);
        }
    }
}

static int64_t clock_ns(void)
{
    struct timespec now;

    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * INT64_C(1000000000) + now.tv_nsec;
}

/* Wait for a frame, until the deadline if there is one; return whether one came. */
static bool receive(const struct bus *bus, struct can_frame *frame, int64_t deadline_ns)
{
    struct pollfd one = {.fd = bus->fd, .events = POLLIN};

    for (;;) {
        if (deadline_ns != JOINT_NO_TIMER) {
            int64_t left_ns = deadline_ns - clock_ns();
            if (poll(&one, 1, left_ns < 0 ? 0 : (int)(left_ns / 1000000) + 1) == 0)
                return false;
        }
        if (read(bus->fd, frame, sizeof *frame) == sizeof *frame)
            return true;
        if (errno != EINTR)
            fail("read", "is the interface up?");
    }
}

/* -- the order of frames -- */

static bool same(const struct can_frame *one, const struct can_frame *other)
{
    return one->can_id == other->can_id && one->can_dlc == other->can_dlc &&
           memcmp(one->data, other->data, one->can_dlc) == 0;
}

static bool sound(const struct can_frame *frame, uint32_t id, uint8_t length)
{
    return frame->can_id == id && joint_sound(id, frame->data, frame->can_dlc, length);
}

/* The cycle of Encoder or AccelRef, modulo 256: the last byte but one. */
static uint8_t cycle_of(const struct can_frame *frame)
{
    return frame->data[frame->can_dlc - 2];
}

static void take_reference(struct board *board, const struct can_frame *frame)
{
    board->references[cycle_of(frame) % 2] = *frame;
    if (!board->announced) {
        board->announced = true;
        board->cycle = -1;
        board->cycle_byte = cycle_of(frame);
    }
}

/* Begin the cycle of Encoder k; return whether AccelRef k - 1 is there, and no other, once there are any. */
static bool begin_cycle(struct board *board, const struct can_frame *encoder)
{
    int64_t cycle = board->cycle + (uint8_t)(cycle_of(encoder) - board->cycle_byte);
    const struct can_frame *reference = &board->references[(cycle - 1) & 1];

    if (!board->by_the_wall && board->announced && cycle >= 0) {
        if (reference->can_dlc == 0 || cycle_of(reference) != (uint8_t)(cycle_of(encoder) - 1))
            return false;
        joint_store(&board->joint, reference->can_id, reference->data, reference->can_dlc);
    }
    board->cycle = cycle;
    board->cycle_byte = cycle_of(encoder);
    return true;
}

/* Hand a frame to the joint; true: send `out`. */
static bool wake(struct board *board, const struct can_frame *frame)
{
    joint_frame(&board->joint, frame->can_id, frame->data, frame->can_dlc,
                board->cycle * board->joint.period_ns, &board->out);
    return true;
}

static bool answer(struct board *board)
{
    if (sound(&board->encoder, board->bus.encoder, ARM_ENCODER_1_LENGTH) && !begin_cycle(board, &board->encoder))
        return false;
    board->waiting = false;
    board->answered = board->encoder;
    return wake(board, &board->encoder);
}

/* Take a frame; return whether to send `out`: that of before, to an Encoder that comes again. */
static bool hear(struct board *board, const struct can_frame *frame)
{
    uint32_t id = frame->can_id;

    if (id == ARM_STOP_FRAME_ID) /* before the first Encoder: of a run before this one */
        return board->answered.can_id != 0 && wake(board, frame);
    if (id == board->bus.encoder) {
        if (!board->by_the_wall && same(frame, &board->answered))
            return true;
        board->encoder = *frame;
        board->waiting = true;
    }
    if (sound(frame, board->bus.accel_ref, ARM_ACCEL_REF_LENGTH))
        take_reference(board, frame);
    if (id == board->bus.parameter || (id == board->bus.accel_ref && board->by_the_wall))
        joint_store(&board->joint, id, frame->data, frame->can_dlc);
    return board->waiting && answer(board);
}

static void play(struct board *board)
{
    int64_t deadline_ns = JOINT_NO_TIMER;
    struct can_frame frame;

    while (!board->joint.finished) {
        if (!receive(&board->bus, &frame, deadline_ns)) {
            joint_timer(&board->joint, &board->out);
        } else {
            int64_t began_ns = clock_ns();

            if (!hear(board, &frame))
                continue;
            deadline_ns = JOINT_NO_TIMER;
            if (board->by_the_wall && board->out.timer_ns != JOINT_NO_TIMER)
                deadline_ns = began_ns + board->out.timer_ns - board->cycle * board->joint.period_ns;
        }
        send_all(&board->bus, &board->out);
    }
}

int main(int argc, char **argv)
{
    long number, joints = 3, period_us = 1000;
    struct board board = {.cycle = -256};
    const struct joint *joint = &board.joint;
    int option;

    while ((option = getopt(argc, argv, "j:p:w")) != -1) {
        joints = option == 'j' ? strtol(optarg, NULL, 10) : joints;
        period_us = option == 'p' ? strtol(optarg, NULL, 10) : period_us;
        board.by_the_wall |= option == 'w';
        if (option == '?')
            return USAGE;
    }
    number = argc - optind == 2 ? strtol(argv[optind + 1], NULL, 10) : 0;
    if (joints > JOINTS || number < 1 || number > joints || period_us < 1) {
        fprintf(stderr, "usage: %s INTERFACE NUMBER [-j JOINTS] [-p PERIOD_US] [-w]; up to %d joints\n", argv[0], JOINTS);
        return USAGE;
    }
    joint_init(&board.joint, (uint8_t)number, (uint8_t)joints, period_us * 1000, 0, 0);
    join(&board.bus, argv[optind], (uint32_t)number);
    printf("joint%ld on %s: waits for the set-up\n", number, argv[optind]);
    fflush(stdout);
    play(&board);
    printf("joint%ld: the run is over; fault %u, %u cycles, %u strikes, %u missed encoders, %u CRC errors, %lu waits\n",
           number, joint->fault, (unsigned)joint->cycles, (unsigned)joint->strikes, (unsigned)joint->missed_encoders,
           (unsigned)joint->crc_errors, board.bus.waits);
    return joint->fault ? STOPPED : 0;
}
