/* The same firmware on a computer: bytes and measurements come from a caller, duties go back. */
#include <string.h>

#include "board.h"

#define OUTBOX 8192

static struct link board;
static uint8_t outbox[OUTBOX];
static unsigned outbox_size;

static bool send(const uint8_t *bytes, uint8_t size)
{
    if (outbox_size + size > OUTBOX)
        return false;
    memcpy(outbox + outbox_size, bytes, size);
    outbox_size += size;
    return true;
}

void host_power_on(void)
{
    outbox_size = 0;
    link_reset(&board, send);
}

void host_receive(const uint8_t *bytes, unsigned size)
{
    while (size--)
        link_receive(&board, *bytes++);
}

void host_step(const struct sensors *sensors, uint32_t now, float *duties, uint8_t *enabled)
{
    link_step(&board, sensors, now);
    *enabled = control_enabled(&board.board);
    for (unsigned i = 0; i < CHANNELS; i++)
        duties[i] = board.board.channels[i].duty;
}

/* Move what the board wants to send to bytes; returns how many. */
unsigned host_take(uint8_t *bytes)
{
    unsigned size = outbox_size;
    memcpy(bytes, outbox, size);
    outbox_size = 0;
    return size;
}

/* For tests: decode what is between two delimiters; the length of the payload, or -1. */
int host_decode(const uint8_t *bytes, uint8_t size, struct frame *frame)
{
    return frame_decode(bytes, size, frame) ? frame->length : -1;
}
