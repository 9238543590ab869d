/*
 * One joint's CPU in C: what firmware_py/joint_cpu.py does, to the bit. No clock, no socket, no heap: it is called with
 * a frame and the time, and says what to send.
 *
 * Ref: docs/board.md; S. Komada, M. Ishida, T. Hori, Control of Robots Using Disturbance Observer, eqs. (5), (6), (8).
 */
#ifndef JOINT_H
#define JOINT_H

#include <stdbool.h>
#include <stdint.h>

#define JOINT_PARAMETERS 5         /* KA, KB, KJ, shift, current limit */
#define JOINT_SIGNALS 6            /* w, dw, KB dw, d, i, i - d: those of the step that may saturate */
#define JOINT_SENDS 4              /* Acknowledge, Stop, Current, State or Heartbeat */
#define JOINT_NO_TIMER INT64_MIN

/* What the step remembers, all in counts; d is 16.16. */
struct joint_law {
    uint32_t saturations[JOINT_SIGNALS];
    int32_t d;
    uint16_t count_prev;
    int16_t w_prev;
    int16_t table[JOINT_PARAMETERS];
};

struct joint_mailbox {
    bool full;
    uint8_t length;
    uint8_t data[8];
};

struct joint {
    struct joint_law law;
    uint32_t crc_errors, strikes, missed_encoders, repeated_encoders, skipped_status;
    uint32_t cycles;               /* Encoder frames answered */
    uint8_t state, fault;          /* as State says them */
    bool finished;                 /* after Stop or a fault: the run is over */

    uint8_t number;                /* 1 to 6 */
    uint8_t turns;                 /* joints + 2: this joint sends State or Heartbeat in cycles k mod turns == number */
    int64_t period_ns;
    int64_t tail_ns;               /* State and Heartbeat are queued so long before the end of their cycle */
    int64_t compute_ns;            /* after which Current is queued */

    uint8_t cycle, version, strikes_in_a_row;
    int16_t a_ref;
    int64_t timer_ns;
    struct joint_mailbox reference, parameter;
};

struct joint_send {
    int64_t delay_ns;              /* after the call */
    uint32_t id;
    uint8_t length;
    uint8_t data[8];
};

/* What to do after a call: frames to queue, in this order; when to call joint_timer (a new time replaces the old). */
struct joint_out {
    int64_t busy_ns, timer_ns;
    int32_t sends;
    struct joint_send send[JOINT_SENDS];
};

void joint_init(struct joint *joint, uint8_t number, uint8_t joints, int64_t period_ns, int64_t tail_ns,
                int64_t compute_ns);

/* Keep AccelRef or Parameter: the newest counts, and is looked at with the next Encoder frame. */
void joint_store(struct joint *joint, uint32_t id, const uint8_t *data, uint8_t length);

/* Answer Encoder or Stop. now_ns: since cycle 0; cycle k begins at k * period_ns. Other identifiers are ignored. */
void joint_frame(struct joint *joint, uint32_t id, const uint8_t *data, uint8_t length, int64_t now_ns,
                 struct joint_out *out);

/* Answer the timer: three Encoder frames in a row have not come. */
void joint_timer(struct joint *joint, struct joint_out *out);

/* The control step: 3 multiplications and 6 additions. */
void joint_step(struct joint_law *law, uint16_t count, int16_t a_ref, int16_t *i, int16_t *estimate);

/* Make up for one or two Encoder frames that never came: half the difference, or the speed is taken to have stayed. */
void joint_bridge(struct joint_law *law, uint16_t count, uint8_t missed);

/* Whether a frame has its length and its CRC-8, which is its last byte. */
bool joint_sound(uint32_t id, const uint8_t *data, uint8_t length, uint8_t wanted);

/* For callers in other languages. */
uint32_t joint_size(void);

#endif
