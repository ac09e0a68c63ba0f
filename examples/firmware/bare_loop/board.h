/* What the loop needs of your board: write these four functions for it. */
#ifndef BOARD_H
#define BOARD_H

int board_wait(void);                          /* until the next period begins; 0 where a stop is asked for */
void board_measure(float *q);                  /* positions of the joints [rad] */
void board_command(const float *tau);          /* torques of the joints [N m], held until the next command */
void board_stop(void);                         /* brakes on, drives off */

#endif
