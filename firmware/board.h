/* The conversation of the board: bytes in, bytes out, and what they do to the motors. */
#ifndef TENDON_BOARD_H
#define TENDON_BOARD_H

#include "control.h"

#define FIRMWARE_VERSION 1
#define LINK_SILENCE 1.0f /* [s] without any good frame: telemetry pauses */

/* codes of RESULT */
enum result {
    DONE = 0,
    WRONG_LENGTH = 1,
    WRONG_VALUE = 2,
    NOT_CONFIGURED = 3,
    FAULT_LATCHED = 4,
    UNKNOWN_TYPE = 5
};

struct link {
    struct board board;
    struct receiver receiver;
    struct frame frame; /* the last good one */
    int32_t cells[CHANNELS];
    uint32_t now, told;  /* [us] of this step, of the last telemetry */
    float silent;        /* [s] since any good frame */
    uint8_t sequence;    /* of the next frame to send */
    uint8_t command_sequence;
    bool (*send)(const uint8_t *bytes, uint8_t size); /* whole frames; false when no room */
};

void link_reset(struct link *link, bool (*send)(const uint8_t *bytes, uint8_t size));
void link_receive(struct link *link, uint8_t byte);

/* Let time pass up to `now` [us]; send telemetry when it is due. */
void link_step(struct link *link, const struct sensors *sensors, uint32_t now);

#endif
