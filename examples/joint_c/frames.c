/* The frames that a joint sends: packed by what cantools made of dbc/arm.dbc, with their CRC. */
#include "frames.h"

#include <string.h>

/* The frames of all joints are alike, and their identifiers count up: those of joint 1 stand for all. */
_Static_assert(ARM_ENCODER_6_FRAME_ID == ARM_ENCODER_1_FRAME_ID + 5, "identifiers count up");
_Static_assert(ARM_ACCEL_REF_2_FRAME_ID == ARM_ACCEL_REF_FRAME_ID + 1, "identifiers count up");
_Static_assert(ARM_PARAMETER_1_INDEX_TABLE_CRC16_CHOICE == JOINT_PARAMETERS, "the CRC is the last index");

/* SAE J1850, most significant bit first. */
static uint8_t crc8_register(uint8_t crc, const uint8_t *data, int length)
{
    for (int n = 0; n < length; n++) {
        crc ^= data[n];
        for (int bit = 0; bit < 8; bit++)
            crc = (uint8_t)(crc << 1 ^ (crc & 0x80 ? 0x1D : 0));
    }
    return crc;
}

static uint8_t frame_crc8(uint32_t id, const uint8_t *data, int length)
{
    const uint8_t identifier[] = {(uint8_t)(id >> 8), (uint8_t)id};

    return crc8_register(crc8_register(0xFF, identifier, 2), data, length) ^ 0xFF;
}

uint16_t table_crc(const int16_t *table)
{
    uint16_t crc = 0xFFFF;

    for (int n = 0; n < 2 * JOINT_PARAMETERS; n++) {
        uint16_t value = (uint16_t)table[n / 2];
        crc ^= (uint16_t)((n % 2 ? value >> 8 : value & 0xFF) << 8);
        for (int bit = 0; bit < 8; bit++)
            crc = (uint16_t)(crc << 1 ^ (crc & 0x8000 ? 0x1021 : 0));
    }
    return crc;
}

bool joint_sound(uint32_t id, const uint8_t *data, uint8_t length, uint8_t wanted)
{
    return length == wanted && frame_crc8(id, data, length - 1) == data[length - 1];
}

/* Queue a frame of this joint, with its CRC; of_joint_1: the identifier that joint 1 would use. */
static void queue(const struct joint *joint, struct joint_out *out, int64_t delay_ns, uint32_t of_joint_1,
                  const uint8_t *data, uint8_t length)
{
    struct joint_send *send = &out->send[out->sends++];

    send->delay_ns = delay_ns;
    send->id = id_of(joint, of_joint_1);
    send->length = length;
    memcpy(send->data, data, length);
    send->data[length - 1] = frame_crc8(send->id, data, length - 1);
}

void queue_stop(struct joint_out *out)
{
    out->send[out->sends++] = (struct joint_send){
        .id = ARM_STOP_FRAME_ID, .length = ARM_STOP_LENGTH, .data = {ARM_STOP_REASON_JOINT_FAULT_CHOICE}};
}

void queue_current(const struct joint *joint, struct joint_out *out, int64_t delay_ns, int16_t i, int16_t estimate)
{
    uint8_t data[8];
    struct arm_current_1_t current = {.reference = i, .estimate = estimate, .cycle = joint->cycle};

    arm_current_1_pack(data, &current, sizeof data);
    queue(joint, out, delay_ns, ARM_CURRENT_1_FRAME_ID, data, ARM_CURRENT_1_LENGTH);
}

static uint32_t at_most(uint32_t x, uint32_t top)
{
    return x < top ? x : top;
}

static void queue_state(const struct joint *joint, struct joint_out *out, int64_t delay_ns, uint8_t cycle)
{
    uint8_t data[8];
    struct arm_state_1_t state = {.state = joint->state, .fault = joint->fault, .cycle = cycle};
    uint32_t saturations = 0;

    for (int n = 0; n < JOINT_SIGNALS; n++)
        saturations = at_most(saturations + at_most(joint->law.saturations[n], UINT16_MAX), UINT16_MAX);
    state.saturations = (uint16_t)saturations;
    state.strikes = (uint8_t)at_most(joint->strikes, UINT8_MAX);
    state.missed = (uint8_t)at_most(joint->missed_encoders, UINT8_MAX);
    arm_state_1_pack(data, &state, sizeof data);
    queue(joint, out, delay_ns, ARM_STATE_1_FRAME_ID, data, ARM_STATE_1_LENGTH);
}

static void queue_heartbeat(const struct joint *joint, struct joint_out *out, int64_t delay_ns, uint8_t cycle)
{
    uint8_t data[8];
    struct arm_heartbeat_1_t beat = {
        .state = joint->state, .version = joint->version, .cycles = joint->cycles, .cycle = cycle};

    arm_heartbeat_1_pack(data, &beat, sizeof data);
    queue(joint, out, delay_ns, ARM_HEARTBEAT_1_FRAME_ID, data, ARM_HEARTBEAT_1_LENGTH);
}

void queue_acknowledge(const struct joint *joint, struct joint_out *out, const struct arm_parameter_1_t *parameter)
{
    uint8_t data[8];
    struct arm_acknowledge_1_t answer = {.index = parameter->index, .value = parameter->value};

    if (parameter->index < JOINT_PARAMETERS)
        answer.value = joint->law.table[parameter->index];
    answer.version = VERSION;
    answer.table_crc = table_crc(joint->law.table);
    arm_acknowledge_1_pack(data, &answer, sizeof data);
    queue(joint, out, joint->compute_ns, ARM_ACKNOWLEDGE_1_FRAME_ID, data, ARM_ACKNOWLEDGE_1_LENGTH);
}

static int64_t floor_div(int64_t x, int64_t y)
{
    return x / y - (x % y < 0);
}

void queue_status(struct joint *joint, int64_t now_ns, struct joint_out *out)
{
    int64_t cycle = floor_div(now_ns, joint->period_ns), turn = floor_div(cycle, joint->turns);
    int64_t delay_ns = (cycle + 1) * joint->period_ns - joint->tail_ns - now_ns;

    joint->cycles++;
    if (cycle - turn * joint->turns != joint->number)
        return;
    if (delay_ns < 0)
        joint->skipped_status++;
    else if (turn % 2 == 0)
        queue_state(joint, out, delay_ns, (uint8_t)cycle);
    else
        queue_heartbeat(joint, out, delay_ns, (uint8_t)cycle);
}
