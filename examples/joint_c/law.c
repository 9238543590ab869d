/*
 * The control law of one joint: the disturbance observer in the words of a 16-bit CPU. What rounds, wraps or saturates
 * is here and nowhere else.
 */
#include "joint.h"

enum { KA, KB, KJ, SHIFT, CURRENT_LIMIT };
enum { KB_DW = 2, D, CURRENT, ERROR };

_Static_assert((-1 >> 1) == -1 && (int16_t)0xFFFFu == -1, "two's complement, shifts floor");

/* Doubles are added in 64 bits only to see whether the sum leaves 32, as an overflow flag would say. */
static int32_t saturate(struct joint_law *law, int signal, int64_t x, int32_t low, int32_t high)
{
    if (x >= low && x <= high)
        return (int32_t)x;
    law->saturations[signal]++;
    return x > high ? high : low;
}

static int16_t saturate16(struct joint_law *law, int signal, int32_t x)
{
    return (int16_t)saturate(law, signal, x, INT16_MIN, INT16_MAX);
}

/* Rounds to the nearest, halves up: the last bit shifted out is added, as SAR and ADC 0 do. */
static int32_t shift_nearest(int32_t x, int shift)
{
    if (shift > 32)
        shift = 32;
    return shift < 1 ? x : ((x >> (shift - 1)) + 1) >> 1;
}

static int32_t limit(struct joint_law *law, int32_t x, int32_t bound)
{
    if (x >= -bound && x <= bound)
        return x;
    law->saturations[CURRENT]++;
    return x > bound ? bound : -bound;
}

void joint_step(struct joint_law *law, uint16_t count, int16_t a_ref, int16_t *i, int16_t *estimate)
{
    const int16_t *k = law->table;
    int16_t w = (int16_t)(uint16_t)(count - law->count_prev);
    int16_t dw = (int16_t)(uint16_t)(w - law->w_prev);
    int16_t error;

    law->d = saturate(law, D, law->d - saturate16(law, KB_DW, (int32_t)k[KB] * dw) * INT64_C(65536), INT32_MIN,
                      INT32_MAX);
    *estimate = (int16_t)(law->d >> 16);
    *i = (int16_t)limit(law, shift_nearest((int32_t)k[KJ] * a_ref, k[SHIFT]) + *estimate, k[CURRENT_LIMIT]);
    error = saturate16(law, ERROR, (int32_t)*i - *estimate);
    law->d = saturate(law, D, law->d + (int64_t)((int32_t)k[KA] * error) * 2, INT32_MIN, INT32_MAX);
    law->count_prev = count;
    law->w_prev = w;
}

void joint_bridge(struct joint_law *law, uint16_t count, uint8_t missed)
{
    int16_t w = law->w_prev;

    if (missed == 1)
        w = (int16_t)((int16_t)(uint16_t)(count - law->count_prev) >> 1);
    law->count_prev = (uint16_t)(count - w);
}
