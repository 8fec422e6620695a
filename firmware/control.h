/* What the board does with its motors: tension loop, limits, rates, release, latched faults.
 *
 * No hardware here: board_step gets what was measured and gives a duty per motor. SI units. */
#ifndef TENDON_CONTROL_H
#define TENDON_CONTROL_H

#include "protocol.h"

#define ALL_CHANNELS ((uint8_t)((1u << CHANNELS) - 1u))

enum mode { TENSION = 0, PULL = 1 };
enum release_to { PRETENSION = 0, LIMP = 1 };

/* faults of a channel: latched, its motor is off until CLEAR */
#define FAULT_OVERLOAD 0x01    /* tension far above its limit */
#define FAULT_OVERHEATING 0x02 /* said by the motor bridge */
#define FAULT_CELL 0x04        /* load cell saturated, or no value for CELL_SILENCE */
#define FAULT_ENCODER 0x08     /* driven hard, and the encoder does not move */
#define FAULT_VOLTAGE 0x10     /* motor supply too low */

/* flags of the board */
#define FLAG_CONFIGURED 0x01 /* SETTINGS and a whole channel have come since power on */
#define FLAG_SILENCE 0x02    /* released because no command came; the next COMMAND clears it */
#define FLAG_RELEASED 0x04   /* released on request; the next COMMAND clears it */

#define CELL_SILENCE 0.3f /* [s] */
#define CELL_LIMIT 0x7FFFFFL

struct sensors {
    int32_t cell;    /* counts of the load-cell converter, 24 bit */
    bool fresh;      /* the converter gave a new value since the last step */
    int32_t ticks;   /* of the encoder */
    int16_t current; /* [mA] */
    uint16_t faults; /* FAULT_OVERHEATING, FAULT_VOLTAGE as seen now */
};

struct channel {
    /* limits, rates, calibration */
    float tension_low, tension_high; /* [N] */
    float pull_low, pull_high;       /* [m] */
    float tension_rate, pull_rate;   /* [N/s], [m/s] */
    int32_t zero;                    /* [counts] */
    float newton_per_count, metre_per_tick;
    /* measured */
    float tension, pull; /* [N], [m] */
    int32_t ticks_seen;
    float cell_age, still; /* [s] since a fresh value; driven hard without turning */
    int16_t current;
    uint16_t faults;
    /* commanded */
    float command;      /* [N] or [m] */
    float goal;         /* [N], moves to the command at its rate */
    float place, extra; /* [m] where the wire should be; [1] integral part of the duty */
    float duty;         /* -1 pays out, +1 winds */
    bool on;
};

struct board {
    struct channel channels[CHANNELS];
    uint8_t limits_known, calibration_known;
    bool settings_known;
    uint8_t flags, mode, release_to;
    float timeout, since_command; /* [s] */
    float release_rate, rest;     /* [N/s], [N] */
    float gain;                   /* [m/(N s)] of the tension loop */
    uint32_t period;              /* [us] of the telemetry */
};

/* As after power on: everything off, nothing known. */
void control_reset(struct board *board);

/* Mask of the channels that may be enabled. */
uint8_t control_configured(const struct board *board);

/* Let time pass: measure, decide, set the duties. */
void control_step(struct board *board, const struct sensors *sensors, float passed);

/* Switch channels on where they are: no jump. False when one of them has a latched fault. */
bool control_enable(struct board *board, uint8_t mode, uint8_t mask);
void control_disable(struct board *board, uint8_t mask);
void control_release(struct board *board, uint8_t flag, uint8_t to);
uint8_t control_enabled(const struct board *board);

#endif
