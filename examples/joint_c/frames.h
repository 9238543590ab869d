/* The frames that a joint sends, as its state machine queues them. */
#ifndef FRAMES_H
#define FRAMES_H

#include "arm.h" /* made from dbc/arm.dbc by cantools */
#include "joint.h"

/* Of the database that arm.h was made from. */
enum { VERSION = ARM_PARAMETER_1_VERSION_THIS_DATABASE_CHOICE };

static inline uint32_t id_of(const struct joint *joint, uint32_t of_joint_1)
{
    return of_joint_1 + joint->number - 1;
}

/* CRC-16/CCITT-FALSE over the values in index order, each low byte first. */
uint16_t table_crc(const int16_t *table);

void queue_current(const struct joint *joint, struct joint_out *out, int64_t delay_ns, int16_t i, int16_t estimate);

/* Reason: joint fault. */
void queue_stop(struct joint_out *out);

/* The answer to a Parameter frame: what stands there now, whatever was asked. */
void queue_acknowledge(const struct joint *joint, struct joint_out *out, const struct arm_parameter_1_t *parameter);

/* State or Heartbeat, by turns, if it is this joint's cycle; a joint that is too late skips it. */
void queue_status(struct joint *joint, int64_t now_ns, struct joint_out *out);

#endif
