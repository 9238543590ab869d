/*
 * The state machine of one joint's CPU: set-up, strikes, missing frames, faults.
 */
#include "joint.h"

#include <string.h>

#include "frames.h"

enum { INIT = ARM_STATE_1_STATE_INIT_CHOICE, READY = ARM_STATE_1_STATE_READY_CHOICE };
enum { RUN = ARM_STATE_1_STATE_RUN_CHOICE, FAULT = ARM_STATE_1_STATE_FAULT_CHOICE };
enum { SHIFT = ARM_PARAMETER_1_INDEX_SHIFT_CHOICE, CURRENT_LIMIT, TABLE_CRC };
enum { MISSES_TO_FAULT = 3, JOINTS_A_FRAME = 3 };

static void enter_fault(struct joint *joint, uint8_t fault)
{
    if (joint->state != FAULT)
        joint->fault = fault;
    joint->state = FAULT;
    joint->timer_ns = JOINT_NO_TIMER;
}

/* -- parameters over CAN -- */

/* With a shift to the left, or a limit that no word can hold, the step cannot compute, whatever their CRC says. */
static bool usable(const int16_t *table)
{
    return table[SHIFT] >= 0 && table[CURRENT_LIMIT] > INT16_MIN;
}

static void write_parameter(struct joint *joint, const struct arm_parameter_1_t *parameter)
{
    if (parameter->version != VERSION) { /* who knows what its entries mean */
        joint->state = INIT;
        joint->fault = ARM_STATE_1_FAULT_PARAMETERS_CHOICE;
        return;
    }
    joint->version = VERSION;
    if (parameter->index < TABLE_CRC) {
        joint->law.table[parameter->index] = parameter->value;
        joint->state = INIT;
    } else if ((uint16_t)parameter->value != table_crc(joint->law.table)) {
        joint->fault = ARM_STATE_1_FAULT_PARAMETERS_CHOICE;
    } else if (!usable(joint->law.table)) {
        enter_fault(joint, ARM_STATE_1_FAULT_PARAMETERS_CHOICE);
    } else {
        joint->state = READY;
        joint->fault = ARM_STATE_1_FAULT_NONE_CHOICE;
        joint->reference.full = false;
        joint->strikes_in_a_row = 0;
    }
}

/* Take one entry of the table and acknowledge it. */
static void take_parameter(struct joint *joint, struct joint_out *out)
{
    struct joint_mailbox *box = &joint->parameter;
    struct arm_parameter_1_t parameter;

    if (!box->full)
        return;
    box->full = false;
    if (!joint_sound(id_of(joint, ARM_PARAMETER_1_FRAME_ID), box->data, box->length, ARM_PARAMETER_1_LENGTH)) {
        joint->crc_errors++;
        return;
    }
    arm_parameter_1_unpack(&parameter, box->data, box->length);
    if ((joint->state == INIT || joint->state == READY) && parameter.index <= TABLE_CRC)
        write_parameter(joint, &parameter);
    queue_acknowledge(joint, out, &parameter);
}

/* -- the state machine -- */

/* Take this joint's value from the AccelRef of the cycle before, never another; return whether it was there. */
static bool take_reference(struct joint *joint, uint8_t cycle)
{
    uint32_t id = ARM_ACCEL_REF_FRAME_ID + (joint->number - 1u) / JOINTS_A_FRAME;
    struct joint_mailbox *box = &joint->reference;
    struct arm_accel_ref_t reference;

    if (!box->full)
        return false;
    if (!joint_sound(id, box->data, box->length, ARM_ACCEL_REF_LENGTH)) {
        joint->crc_errors++;
        box->full = false;
        return false;
    }
    arm_accel_ref_unpack(&reference, box->data, box->length);
    if (reference.cycle != (uint8_t)(cycle - 1))
        return false;
    joint->a_ref = (int16_t[]){reference.joint1, reference.joint2,
                               reference.joint3}[(joint->number - 1) % JOINTS_A_FRAME];
    return true;
}

/* Return whether the reference was there; if not, the old one holds, and the third strike in a row is a fault. */
static bool count_strikes(struct joint *joint, uint8_t cycle)
{
    if (take_reference(joint, cycle)) {
        joint->strikes_in_a_row = 0;
        return true;
    }
    joint->strikes++;
    if (++joint->strikes_in_a_row >= MISSES_TO_FAULT)
        enter_fault(joint, ARM_STATE_1_FAULT_REFERENCE_LOST_CHOICE);
    return false;
}

static void count_misses(struct joint *joint, uint16_t count, uint8_t cycle)
{
    uint8_t missed = (uint8_t)(cycle - joint->cycle - 1);

    joint->missed_encoders += missed;
    if (missed >= MISSES_TO_FAULT)
        enter_fault(joint, ARM_STATE_1_FAULT_ENCODER_LOST_CHOICE);
    else if (missed > 0)
        joint_bridge(&joint->law, count, missed);
}

static void follow(struct joint *joint, uint16_t count, uint8_t cycle, int64_t now_ns)
{
    if (joint->state == READY && joint->reference.full) {
        if (count_strikes(joint, cycle)) { /* the first reference: this is cycle 0 */
            joint->state = RUN;
            joint->law.count_prev = count;
            joint->law.w_prev = 0;
            joint->law.d = 0;
        }
    } else if (joint->state == RUN) {
        count_misses(joint, count, cycle);
        count_strikes(joint, cycle);
    }
    if (joint->state == RUN)
        joint->timer_ns = now_ns + MISSES_TO_FAULT * joint->period_ns + joint->period_ns / 2;
}

/* Return whether a run is on without this joint, as after a reset in its middle: references come, and it is in init. */
static bool left_out(struct joint *joint, uint8_t cycle)
{
    bool on = take_reference(joint, cycle);

    joint->reference.full = false;
    if (on)
        joint->fault = ARM_STATE_1_FAULT_NODE_NOT_READY_CHOICE;
    return on;
}

static void stop(struct joint *joint, uint8_t reason, struct joint_out *out)
{
    joint->finished = true;
    if (joint->state != FAULT) {
        joint->state = INIT;
        joint->fault = reason == ARM_STOP_REASON_END_CHOICE ? ARM_STATE_1_FAULT_NONE_CHOICE
                                                            : ARM_STATE_1_FAULT_STOPPED_CHOICE;
    }
    joint->timer_ns = JOINT_NO_TIMER;
    joint->reference.full = false;
    queue_current(joint, out, 0, 0, 0);
}

static void answer(struct joint *joint, const struct arm_encoder_1_t *encoder, int64_t now_ns, struct joint_out *out)
{
    int16_t i = 0, estimate = 0;

    if (joint->state == RUN && encoder->cycle == joint->cycle) {
        joint->repeated_encoders++;
        return;
    }
    take_parameter(joint, out);
    follow(joint, encoder->position, encoder->cycle, now_ns);
    if (joint->state == RUN) {
        joint_step(&joint->law, encoder->position, joint->a_ref, &i, &estimate);
    } else if (joint->state == FAULT) {
        joint->finished = true;
        queue_stop(out);
    } else if (joint->state == INIT && left_out(joint, encoder->cycle)) {
        queue_stop(out);
    }
    joint->cycle = encoder->cycle;
    queue_current(joint, out, joint->compute_ns, i, estimate);
    queue_status(joint, now_ns, out);
    out->busy_ns = joint->compute_ns;
}

/* -- what the driver calls -- */

void joint_init(struct joint *joint, uint8_t number, uint8_t joints, int64_t period_ns, int64_t tail_ns,
                int64_t compute_ns)
{
    memset(joint, 0, sizeof *joint);
    joint->number = number;
    joint->turns = (uint8_t)(joints + 2);
    joint->period_ns = period_ns;
    joint->tail_ns = tail_ns;
    joint->compute_ns = compute_ns;
    joint->timer_ns = JOINT_NO_TIMER;
}

void joint_store(struct joint *joint, uint32_t id, const uint8_t *data, uint8_t length)
{
    bool accel_ref = id == ARM_ACCEL_REF_FRAME_ID + (joint->number - 1u) / JOINTS_A_FRAME;
    struct joint_mailbox *box = accel_ref ? &joint->reference : &joint->parameter;

    if (length > sizeof box->data || (!accel_ref && id != id_of(joint, ARM_PARAMETER_1_FRAME_ID)))
        return;
    box->full = true;
    box->length = length;
    memcpy(box->data, data, length);
}

void joint_frame(struct joint *joint, uint32_t id, const uint8_t *data, uint8_t length, int64_t now_ns,
                 struct joint_out *out)
{
    struct arm_encoder_1_t encoder;
    bool ours = id == id_of(joint, ARM_ENCODER_1_FRAME_ID);

    memset(out, 0, sizeof *out);
    if (id == ARM_STOP_FRAME_ID && length == ARM_STOP_LENGTH) {
        stop(joint, data[0], out);
    } else if (ours && joint_sound(id, data, length, ARM_ENCODER_1_LENGTH)) {
        arm_encoder_1_unpack(&encoder, data, length);
        answer(joint, &encoder, now_ns, out);
    } else if (ours || id == ARM_STOP_FRAME_ID) {
        joint->crc_errors++;
    }
    out->timer_ns = joint->timer_ns;
}

void joint_timer(struct joint *joint, struct joint_out *out)
{
    memset(out, 0, sizeof *out);
    enter_fault(joint, ARM_STATE_1_FAULT_ENCODER_LOST_CHOICE);
    joint->finished = true;
    queue_current(joint, out, 0, 0, 0);
    queue_stop(out);
    out->timer_ns = JOINT_NO_TIMER;
}

uint32_t joint_size(void)
{
    return sizeof(struct joint);
}
