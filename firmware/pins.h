/* Which wire goes where. Arduino Mega 2560; change here for another board.
 *
 * motor bridge (two inputs per motor, such as DRV8871): PWM on IN1 or IN2, both low = free
 * HX711: data per cell, one clock for all; its pin RATE high = 80 samples a second
 * encoder: A on an external interrupt, B read when A changes */
#ifndef TENDON_PINS_H
#define TENDON_PINS_H

#include <avr/io.h>
#include <stdint.h>

#include "protocol.h"

#define BAUD 1000000UL

#if !defined(__AVR_ATmega2560__) && !defined(__AVR_ATmega328P__)
#error "pins.h knows the ATmega2560 and the ATmega328P; add the pins of your board"
#endif

#if defined(__AVR_ATmega2560__) /* up to four tendons */

/* encoders: A on INT0 to INT3 (Arduino 21, 20, 19, 18), B on port K (A8 to A11) */
#define ENCODER_B_PIN PINK
#define ENCODER_B(i) (1 << (i))
#define ENCODER_A(i) (1 << (i)) /* of port D */
#define ENCODER_EDGES() (EICRA = 0x55, EIMSK = 0x0F) /* any edge */
#define ENCODER_PULL_UPS() (PORTD |= 0x0F, PORTK |= 0x0F)

/* load cells: clock on PA0 (Arduino 22), data on port C bits 0 to 3 (37, 36, 35, 34) */
#define CELL_CLOCK_PORT PORTA
#define CELL_CLOCK_DDR DDRA
#define CELL_CLOCK_BIT 0x01
#define CELL_DATA_PIN PINC
#define CELL_DATA(i) (1 << (i))
#define CELL_PULL_UPS() (PORTC |= 0x0F)

/* motor bridges, IN1 IN2: OC3A OC3B, OC3C OC4A, OC4B OC4C, OC5A OC5B
 * (Arduino 5 2, 3 6, 7 8, 46 45) */
static inline void bridge_begin(void)
{
    DDRE |= 0x38;
    DDRH |= 0x38;
    DDRL |= 0x18;
    TCCR3A = 0xA9; /* 8 bit, phase correct: a duty of 0 stays low */
    TCCR4A = 0xA9;
    TCCR5A = 0xA1;
    TCCR3B = TCCR4B = TCCR5B = 0x01; /* 31 kHz */
}

static inline void bridge_set(uint8_t i, uint8_t wind, uint8_t pay_out)
{
    switch (i) {
    case 0:
        OCR3A = wind;
        OCR3B = pay_out;
        break;
    case 1:
        OCR3C = wind;
        OCR4A = pay_out;
        break;
    case 2:
        OCR4B = wind;
        OCR4C = pay_out;
        break;
    default:
        OCR5A = wind;
        OCR5B = pay_out;
    }
}

/* currents on A0 to A3, motor supply through a divider on A4 */
#define SUPPLY_INPUT 4

#else /* ATmega328P (Uno, Nano): up to two tendons */

#if CHANNELS > 2
#error "an ATmega328P has pins for two tendons: make MCU=atmega328p CHANNELS=2"
#endif
/* encoders: A on INT0, INT1 (Arduino 2, 3), B on PD4, PD7 (4, 7) */
#define ENCODER_B_PIN PIND
#define ENCODER_B(i) ((i) ? 0x80 : 0x10)
#define ENCODER_A(i) (4 << (i)) /* of port D */
#define ENCODER_EDGES() (EICRA = 0x05, EIMSK = 0x03)
#define ENCODER_PULL_UPS() (PORTD |= 0x9C)

/* load cells: clock on PB4 (12), data on PB0 (8) and PB5 (13) */
#define CELL_CLOCK_PORT PORTB
#define CELL_CLOCK_DDR DDRB
#define CELL_CLOCK_BIT 0x10
#define CELL_DATA_PIN PINB
#define CELL_DATA(i) ((i) ? 0x20 : 0x01)
#define CELL_PULL_UPS() (PORTB |= 0x21)

/* motor bridges, IN1 IN2: OC0A OC0B, OC1A OC1B (6 5, 9 10) */
static inline void bridge_begin(void)
{
    DDRD |= 0x60;
    DDRB |= 0x06;
    TCCR0A = TCCR1A = 0xA1; /* 8 bit, phase correct: a duty of 0 stays low */
    TCCR0B = TCCR1B = 0x01; /* 31 kHz */
}

static inline void bridge_set(uint8_t i, uint8_t wind, uint8_t pay_out)
{
    if (i == 0) {
        OCR0A = wind;
        OCR0B = pay_out;
    } else {
        OCR1A = wind;
        OCR1B = pay_out;
    }
}

/* currents on A0, A1, motor supply through a divider on A4 */
#define SUPPLY_INPUT 4

#endif

/* current: 0.5 V/A into a 10-bit converter with 5 V reference; supply: 1 to 5 divider */
#define MILLIAMPERE_PER_COUNT 10
#define MILLIVOLT_PER_COUNT 24
#define LOWEST_SUPPLY 6000 /* [mV] below this FAULT_VOLTAGE */

#endif
