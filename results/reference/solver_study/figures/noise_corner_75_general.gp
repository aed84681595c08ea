set terminal svg standalone size 1000,900 dynamic noenhanced background rgb 'white' font 'sans,13'
set output 'noise_corner_75_general.svg'
set datafile separator ','
set key outside right top
set grid lc rgb '#dddddd'
top = 4
under(y) = y < top ? y : top
set yrange [0.97:1.03 * top]
set nonlinear y via log10(y - 0.9) inverse 0.9 + 10**y
set ylabel 'RMSE over bound'
set ytics (1, 1.02, 1.05, 1.1, 1.2, 1.5, 2, 3, 4)
set xtics rotate by -25 ('posit_undistorted' 0, 'aopit' 1, 'aopit_ray' 2, 'ml_ray' 3, 'oi_ray' 4, 'prsoi' 5, 'opencv_sqpnp' 6, 'opencv_epnp' 7, 'opencv_iterative' 8)
set xrange [-0.6:8.6]
set multiplot layout 2,1
set title '0.05 px'
plot 1 with lines lc rgb '#888888' notitle, 'noise_corner_75_general.csv' every ::1 using ($1 == 0.05 && $2 == 0 ? $3 + -0.22499999999999998 : 1/0):(under($5)):(under($6)):(under($7)) with yerrorbars pt 7 ps 0.9 lc rgb '#0072B2' title 'central', 'noise_corner_75_general.csv' every ::1 using ($1 == 0.05 && $2 == 2 ? $3 + -0.075 : 1/0):(under($5)):(under($6)):(under($7)) with yerrorbars pt 5 ps 0.9 lc rgb '#D55E00' title '2 mm', 'noise_corner_75_general.csv' every ::1 using ($1 == 0.05 && $2 == 12 ? $3 + 0.075 : 1/0):(under($5)):(under($6)):(under($7)) with yerrorbars pt 9 ps 0.9 lc rgb '#009E73' title '12 mm', 'noise_corner_75_general.csv' every ::1 using ($1 == 0.05 && $2 == 30 ? $3 + 0.22499999999999998 : 1/0):(under($5)):(under($6)):(under($7)) with yerrorbars pt 13 ps 0.9 lc rgb '#CC79A7' title '30 mm'
set title '0.5 px'
plot 1 with lines lc rgb '#888888' notitle, 'noise_corner_75_general.csv' every ::1 using ($1 == 0.5 && $2 == 0 ? $3 + -0.22499999999999998 : 1/0):(under($5)):(under($6)):(under($7)) with yerrorbars pt 7 ps 0.9 lc rgb '#0072B2' title 'central', 'noise_corner_75_general.csv' every ::1 using ($1 == 0.5 && $2 == 2 ? $3 + -0.075 : 1/0):(under($5)):(under($6)):(under($7)) with yerrorbars pt 5 ps 0.9 lc rgb '#D55E00' title '2 mm', 'noise_corner_75_general.csv' every ::1 using ($1 == 0.5 && $2 == 12 ? $3 + 0.075 : 1/0):(under($5)):(under($6)):(under($7)) with yerrorbars pt 9 ps 0.9 lc rgb '#009E73' title '12 mm', 'noise_corner_75_general.csv' every ::1 using ($1 == 0.5 && $2 == 30 ? $3 + 0.22499999999999998 : 1/0):(under($5)):(under($6)):(under($7)) with yerrorbars pt 13 ps 0.9 lc rgb '#CC79A7' title '30 mm'
unset multiplot
