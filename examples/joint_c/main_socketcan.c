/*
 * Joint N on a SocketCAN interface: joint_socketcan INTERFACE NUMBER [-j JOINTS] [-p PERIOD_US] [-w]
 *
 * One blocking read loop: every frame is answered when it comes, State and Heartbeat behind Current. Time is counted by
 * the cycles of the Encoder frames, so a stopped bus is stopped time (`sync`); with -w silence of the encoder is a
 * fault by the machine's clock (`wall`). Ends as the Python node does: at Stop or in a fault.
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

/* What cycle it is: Encoder counts modulo 256, from -256 at the earliest; the first AccelRef is that of cycle -1. */
struct cycles {
    int64_t now;
    uint8_t byte;
    bool announced;
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

/* Follow the cycle counter of sound frames. */
static void count_cycles(struct cycles *cycles, const struct bus *bus, const struct can_frame *frame)
{
    if (frame->can_id == bus->encoder && joint_sound(bus->encoder, frame->data, frame->can_dlc, ARM_ENCODER_1_LENGTH)) {
        uint8_t byte = frame->data[2];
        cycles->now += (uint8_t)(byte - cycles->byte);
        cycles->byte = byte;
    } else if (frame->can_id == bus->accel_ref && !cycles->announced &&
               joint_sound(bus->accel_ref, frame->data, frame->can_dlc, ARM_ACCEL_REF_LENGTH)) {
        cycles->now = -1;
        cycles->byte = frame->data[6];
        cycles->announced = true;
    }
}

static void play(struct joint *joint, struct bus *bus, bool by_the_wall)
{
    struct cycles cycles = {.now = -256};
    int64_t deadline_ns = JOINT_NO_TIMER;
    struct joint_out out;
    struct can_frame frame;

    while (!joint->finished) {
        if (!receive(bus, &frame, deadline_ns)) {
            joint_timer(joint, &out);
        } else {
            int64_t began_ns = clock_ns(), now_ns;

            count_cycles(&cycles, bus, &frame);
            if (frame.can_id == bus->accel_ref || frame.can_id == bus->parameter) {
                joint_store(joint, frame.can_id, frame.data, frame.can_dlc);
                continue;
            }
            now_ns = cycles.now * joint->period_ns;
            joint_frame(joint, frame.can_id, frame.data, frame.can_dlc, now_ns, &out);
            if (!by_the_wall || out.timer_ns == JOINT_NO_TIMER)
                deadline_ns = JOINT_NO_TIMER;
            else
                deadline_ns = began_ns + out.timer_ns - now_ns;
        }
        send_all(bus, &out);
    }
}

int main(int argc, char **argv)
{
    long number, joints = 3, period_us = 1000;
    bool by_the_wall = false;
    struct joint joint;
    struct bus bus = {0};
    int option;

    while ((option = getopt(argc, argv, "j:p:w")) != -1) {
        joints = option == 'j' ? strtol(optarg, NULL, 10) : joints;
        period_us = option == 'p' ? strtol(optarg, NULL, 10) : period_us;
        by_the_wall |= option == 'w';
        if (option == '?')
            return USAGE;
    }
    number = argc - optind == 2 ? strtol(argv[optind + 1], NULL, 10) : 0;
    if (joints > JOINTS || number < 1 || number > joints || period_us < 1) {
        fprintf(stderr, "usage: %s INTERFACE NUMBER [-j JOINTS] [-p PERIOD_US] [-w]; up to %d joints\n", argv[0], JOINTS);
        return USAGE;
    }
    joint_init(&joint, (uint8_t)number, (uint8_t)joints, period_us * 1000, 0, 0);
    join(&bus, argv[optind], (uint32_t)number);
    printf("joint%ld on %s: waits for the set-up\n", number, argv[optind]);
    fflush(stdout);
    play(&joint, &bus, by_the_wall);
    printf("joint%ld: the run is over; fault %u, %u cycles, %u strikes, %u missed encoders, %u CRC errors, %lu waits\n",
           number, joint.fault, (unsigned)joint.cycles, (unsigned)joint.strikes, (unsigned)joint.missed_encoders,
           (unsigned)joint.crc_errors, bus.waits);
    return joint.fault ? STOPPED : 0;
}
